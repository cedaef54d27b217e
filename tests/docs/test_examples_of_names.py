"""Every public name is described, and its examples run."""

import doctest
import importlib
import inspect
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpydoc.validate
import pytest
from numpydoc.docscrape import NumpyDocString

import sdpid

API = Path(__file__).resolve().parents[2] / "docs" / "reference" / "api"
NAMESPACES = ("constraints", "controllers", "errors", "friction", "plots")
OBJECTS = re.compile(r"^\.\. auto(?:class|function|exception):: (\S+)$", re.M)
FLAGS = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE

# What `numpydoc.validate` must not find: no docstring; missing, unknown, disordered parameters,
# parameters without a type or a description; no summary in a sentence; unknown or disordered
# sections; nothing said of what is returned; no examples.
CHECKS = {
    *("GL06", "GL07", "GL08", "PR01", "PR02", "PR03", "PR04", "PR07"),
    *("SS01", "SS02", "SS03", "SS06", "RT01", "EX01"),
}


def public_names() -> list[str]:
    """Return the dotted names of everything that users import."""
    modules = {"sdpid": set(sdpid.__all__) - {"__version__", *NAMESPACES}}
    modules |= {f"sdpid.{name}": set(getattr(sdpid, name).__all__) for name in NAMESPACES}
    return sorted(f"{module}.{name}" for module, names in modules.items() for name in names)


def names_of_the_pages() -> list[str]:
    """Return the dotted names that have an entry on the API pages."""
    pages = sorted(API.glob("*.md"))
    return [name for page in pages for name in OBJECTS.findall(page.read_text(encoding="utf-8"))]


NAMES = sorted({*public_names(), *names_of_the_pages()})


def resolve(name: str) -> Any:
    module, _, attribute = name.rpartition(".")
    return getattr(importlib.import_module(module), attribute)


def test_every_public_name_stands_on_one_page() -> None:
    shown = names_of_the_pages()
    assert set(public_names()) <= set(shown)
    assert len(shown) == len(set(shown))


def test_the_index_lists_every_public_name(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(API.parents[1] / "_ext"))
    from summaries import lines

    pages = re.findall(r"^```\{summaries\} (\w+)$", (API / "index.md").read_text("utf-8"), re.M)
    rows = [line.split("`")[1] for page in pages for line in lines(API / f"{page}.md")[2:] if line]
    assert sorted(name for name in rows if not name.startswith("~")) == public_names()


@pytest.mark.parametrize("name", NAMES)
def test_a_docstring_says_what_users_need(name: str) -> None:
    found = resolve(name)
    errors = set(_errors(name, found))
    assert not errors


def _errors(name: str, found: Any) -> Iterator[str]:
    validated = f"{found.__module__}.{found.__qualname__}"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        result = numpydoc.validate.validate(validated)
    # A dataclass describes its fields as attributes; an error is caught and never made by users.
    fields = inspect.isclass(found) and bool(NumpyDocString(inspect.getdoc(found))["Attributes"])
    for code, message in result["errors"]:
        if code not in CHECKS or (fields and code in {"PR01", "PR03"}):
            continue
        yield f"{code}: {message}"
    if fields and not issubclass(found, Exception):
        yield from _undescribed(found)


def _undescribed(found: type) -> Iterator[str]:
    """Say which arguments of a class neither it nor a base describes."""
    described = {
        name.strip()
        for kind in ("Parameters", "Attributes")
        for each in found.__mro__[:-1]
        for entry in NumpyDocString(inspect.cleandoc(each.__doc__ or ""))[kind]
        for name in entry.name.split(",")
    }
    arguments = {name for name in inspect.signature(found).parameters if not name.startswith("_")}
    yield from (f"undescribed: {name}" for name in arguments - described)
    known = {*arguments, *dir(found), *getattr(found, "__annotations__", ())}
    yield from (f"unknown: {name}" for name in described - known)


@pytest.fixture(scope="session")
def start(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return the namespace that the lines of the index page make."""
    lines = re.findall(r"^```python\n(.*?)^```", (API / "index.md").read_text("utf-8"), re.M | re.S)
    names: dict[str, Any] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("start"))
        exec(compile(lines[0], "docs/reference/api/index.md", "exec"), names)
    return names


@pytest.mark.parametrize("name", NAMES)
def test_examples_run(
    name: str, start: dict[str, Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    found = inspect.unwrap(resolve(name))
    parser = doctest.DocTestParser()
    test = parser.get_doctest(inspect.getdoc(found) or "", dict(start), name, name, None)
    assert test.examples
    output: list[str] = []
    runner = doctest.DocTestRunner(optionflags=FLAGS)
    runner.run(test, out=output.append)
    assert not runner.failures, "".join(output)
