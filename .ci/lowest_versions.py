"""Print a constraints file for pip with the lowest version of each dependency of pyproject.toml."""

import sys
from pathlib import Path

from packaging.requirements import Requirement

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

project = tomllib.loads(Path("pyproject.toml").read_text(encoding="utf-8"))["project"]
extras = project["optional-dependencies"].values()
lowest = {}
for text in [*project["dependencies"], *(line for extra in extras for line in extra)]:
    requirement = Requirement(text)
    if requirement.name == project["name"]:
        continue
    if requirement.marker is not None and not requirement.marker.evaluate():
        continue
    bounds = [each.version for each in requirement.specifier if each.operator == ">="]
    if len(bounds) != 1:
        sys.exit(f"pyproject.toml: '{text}' declares no lowest version; write 'name>=version'.")
    lowest[requirement.name] = bounds[0]
for name, version in sorted(lowest.items()):
    print(f"{name}=={version}")
