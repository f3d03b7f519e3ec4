"""VTK's readers and writers, each imported when its format is met: the lean way to start VTK."""

from form import is_ascii_ply


def smoothed_file(source, target, smoother):
    """Read, let the filter ``smoother`` work with its settings, write the same kind of file."""
    reader, writer = READERS[source[-4:]](), WRITERS[source[-4:]]()
    reader.SetFileName(source)
    if source.endswith(".ply") and is_ascii_ply(source):
        writer.SetFileTypeToASCII()
    elif not source.endswith(".obj"):
        writer.SetFileTypeToBinary()
    smoother.SetInputConnection(reader.GetOutputPort())
    writer.SetInputConnection(smoother.GetOutputPort())
    writer.SetFileName(target)
    if not writer.Write():
        raise OSError(f"VTK did not write {target}")


def ply_reader():
    from vtkmodules.vtkIOPLY import vtkPLYReader

    return vtkPLYReader()


def ply_writer():
    from vtkmodules.vtkIOPLY import vtkPLYWriter

    return vtkPLYWriter()


def obj_reader():
    from vtkmodules.vtkIOGeometry import vtkOBJReader

    return vtkOBJReader()


def obj_writer():
    from vtkmodules.vtkIOGeometry import vtkOBJWriter

    return vtkOBJWriter()


def stl_reader():
    from vtkmodules.vtkIOGeometry import vtkSTLReader

    return vtkSTLReader()


def stl_writer():
    from vtkmodules.vtkIOGeometry import vtkSTLWriter

    return vtkSTLWriter()


READERS = {".ply": ply_reader, ".obj": obj_reader, ".stl": stl_reader}
WRITERS = {".ply": ply_writer, ".obj": obj_writer, ".stl": stl_writer}
