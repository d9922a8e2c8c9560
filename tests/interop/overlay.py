"""Looks up packages in a sourced overlay through the real ament index, like the commands of ros2cli; prints JSON.

usage: overlay.py SOURCE_PACKAGE_XML ...

For each package what parsing its package.xml complained of, its prefix, its share folder, what `ros2 run` would find
(ros2pkg: executable files under lib/PACKAGE), what `ros2 launch` would find (ros2launch: files under share/PACKAGE, by
name), and what `ros2 interface` would find (rosidl_runtime_py: the index of interfaces, and their files). Launch files in
XML are read for what they include; those in Python are compiled only: PyPI has no `launch` to run either.
"""

import json
import os
import re
import sys
from pathlib import Path
from xml.etree import ElementTree

from ament_index_python import get_package_prefix, get_package_share_directory, get_resource, has_resource
from catkin_pkg.package import parse_package


def executables(folder):
    for path in sorted(folder.rglob("*")):
        if path.is_file() and os.access(path, os.X_OK):
            yield path


def includes(path):
    if path.suffix == ".py":
        compile(path.read_text(), path, "exec")
    if path.suffix != ".xml":
        return
    for include in ElementTree.parse(path).iter("include"):
        share = r"\$\(find-pkg-share (\w+)\)"
        yield re.sub(share, lambda found: get_package_share_directory(found[1]), include.get("file"))


def look_up(package_xml):
    warnings = []
    package = parse_package(package_xml, warnings=warnings)
    prefix, share = Path(get_package_prefix(package.name)), Path(get_package_share_directory(package.name))
    launch = {}
    for path in share.rglob("*.launch.*"):
        launch.setdefault(path.name, []).append({"path": str(path), "includes": list(includes(path))})
    interfaces = {}
    if has_resource("rosidl_interfaces", package.name):
        for name in get_resource("rosidl_interfaces", package.name)[0].splitlines():
            if not name.endswith(".idl"):
                interfaces[name] = (share / name).read_text()
    return package.name, {
        "warnings": warnings,
        "licenses": package.licenses,
        "build_type": package.get_build_type(),
        "version": package.version,
        "prefix": str(prefix),
        "share": str(share),
        "executables": {path.name: str(path) for path in executables(prefix / "lib" / package.name)},
        "launch": launch,
        "interfaces": interfaces,
    }


json.dump(dict(look_up(Path(xml)) for xml in sys.argv[1:]), sys.stdout)
print()
