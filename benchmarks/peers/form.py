"""Whether a PLY file is text, so that a peer writes the kind of file that it read."""


def is_ascii_ply(source):
    """From the second line of the file, where PLY says so."""
    with open(source, "rb") as stream:
        return stream.read(40).split()[1:3] == [b"format", b"ascii"]
