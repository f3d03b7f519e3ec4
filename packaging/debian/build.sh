#!/bin/sh
# Make a Debian package from wheels, without a network:
#
#     /usr/bin/python3 -m pip download --only-binary :all: -d wheels msal_cli-....whl    # with a network
#     sh packaging/debian/build.sh wheels dist
#
# The wheels are those of msal and of all that it needs, for the system's Python: Debian 12 has no
# trimesh, and its numpy is too old.  They are unpacked into /usr/lib/msal-cli, where no other
# program finds them.  Needs dpkg-deb, and PYTHON (/usr/bin/python3) with pip.
set -eu

wheels=$1
folder=$2
python=${PYTHON:-/usr/bin/python3}
here=$(CDPATH='' cd -- "$(dirname -- "$0")" && pwd)
tree=$(mktemp -d)
trap 'rm -rf "$tree"' EXIT

library=$tree/usr/lib/msal-cli
mkdir -p "$library" "$tree/usr/bin" "$tree/usr/share/doc/msal-cli" "$tree/DEBIAN"
"$python" -m pip install --quiet --disable-pip-version-check --root-user-action ignore --no-compile \
    --no-index --find-links "$wheels" --target "$library" msal-cli
# pip's scripts name the python3 of this machine.
rm -rf "$library/bin"
mkdir -p "$tree/usr/share/man/man1"
for page in "$library"/share/man/man1/msal*.1; do
    if [ -f "$page" ]; then gzip -9n <"$page" >"$tree/usr/share/man/man1/${page##*/}.gz"; fi
done
rm -rf "$library/share"

cp "$here/msal" "$tree/usr/bin/msal"
cp "$here/copyright" "$tree/usr/share/doc/msal-cli/copyright"
cp "$here/postinst" "$here/prerm" "$tree/DEBIAN/"

about=$(echo "$library"/msal_cli-*.dist-info)
version=${about##*/msal_cli-}
version=${version%.dist-info}
# A pre-release such as 1.0rc1 sorts before 1.0.
version=$(echo "$version" | sed -E 's/([0-9])((a|b|rc|\.dev)[0-9]+)$/\1~\2/')-1
if find "$library" -name '*.so*' | grep -q .; then
    architecture=$(dpkg --print-architecture)
else
    architecture=all
fi
sed -e "s/@VERSION@/$version/" -e "s/@ARCHITECTURE@/$architecture/" \
    -e "s/@SIZE@/$(du -sk "$tree/usr" | cut -f1)/" \
    -e "s/@PYTHON@/$("$python" -c 'import sys; print("3.%d" % sys.version_info[1])')/" \
    -e "s/@NEXT_PYTHON@/$("$python" -c 'import sys; print("3.%d" % (sys.version_info[1] + 1))')/" \
    "$here/control" >"$tree/DEBIAN/control"

chmod -R u=rwX,go=rX "$tree"
chmod 755 "$tree/usr/bin/msal" "$tree/DEBIAN/postinst" "$tree/DEBIAN/prerm"
mkdir -p "$folder"
dpkg-deb --root-owner-group --build "$tree" "$folder/msal-cli_${version}_$architecture.deb"
