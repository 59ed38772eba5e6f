"""The documentation runs: its code blocks are executed, and what it shows is what comes out.

Rules for README, ARCHITECTURE, CHANGELOG and docs, each page in a folder and a namespace of its own:

- ```python is executed; a ```text right after it is what it prints.
- ```console holds commands after "$ " and what they print; a command fails only where `echo $?` follows.
- ```bash holds commands only. Commands that begin with make or git are not run; a make target must exist.
- ```toml is loaded as a plant or a suite and saved under the name in the line above it, such as `plant.toml`.
- ```text elsewhere is for people. Shown output may leave out a part with "...".
"""

import ast
import contextlib
import doctest
import io
import os
import re
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import pytest

import securestate
from securestate import Estimator, Plant
from securestate.simulation.suite import load_suite

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    "README.md",
    "ARCHITECTURE.md",
    "CHANGELOG.md",
    *sorted(f"docs/{p.name}" for p in ROOT.glob("docs/*.md")),
]
LANGUAGES = {"python", "console", "bash", "toml", "text"}
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.MULTILINE | re.DOTALL)


@dataclass(frozen=True)
class Block:
    language: str
    text: str
    place: str  # file:line, for messages
    above: str  # the line of text before the block
    shown: str | None  # the ```text block right after it


def page(name: str) -> str:
    return (ROOT / name).read_text(encoding="utf-8")


def blocks(name: str) -> list[Block]:
    text = page(name)
    found = list(FENCE.finditer(text))
    result = []
    for match, after in zip_longest(found, found[1:]):
        follows = after is not None and after[1] == "text" and not text[match.end() : after.start()].strip()
        lines = text[: match.start()].strip().splitlines()
        result.append(
            Block(
                language=match[1],
                text=match[2],
                place=f"{name}:{text[: match.start()].count(chr(10)) + 1}",
                above=lines[-1] if lines else "",
                shown=after[2] if after is not None and follows else None,
            )
        )
    return result


def assert_shown(place: str, shown: str, printed: str) -> None:
    options = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    same = doctest.OutputChecker().check_output(shown.strip() + "\n", printed.strip() + "\n", options)
    assert same, f"{place} shows\n{shown}\nbut this comes out:\n{printed}"


def run_python(block: Block, namespace: dict[str, Any]) -> None:
    printed = io.StringIO()
    code = compile(block.text, block.place, "exec")
    with contextlib.redirect_stdout(printed):
        exec(code, namespace)
    if block.shown is not None or printed.getvalue():
        assert_shown(block.place, block.shown or "", printed.getvalue())


def commands(block: Block) -> list[tuple[str, str]]:
    """Commands with what the block shows of their output."""
    if block.language == "bash":
        return [(line, "") for line in block.text.splitlines() if line.strip()]
    parts = re.split(r"^\$ ", block.text, flags=re.MULTILINE)
    assert not parts[0].strip(), f"{block.place}: begins without a command"
    return [(command, output) for command, _, output in (part.partition("\n") for part in parts[1:])]


def run_commands(block: Block, folder: Path) -> None:
    code, checked = 0, True
    for command, shown in commands(block):
        if command.startswith(("make ", "git ")):
            assert_target_exists(block.place, command)
            continue
        asks = command == "echo $?"
        assert checked or asks, f"{block.place}: the command before {command!r} ended with {code}"
        done = in_shell(f"(exit {code}); {command}", folder)
        code, checked = done.returncode, done.returncode == 0
        if block.language == "console":
            assert_shown(f"{block.place}, {command}", shown, done.stdout + done.stderr)
    assert checked, f"{block.place}: the last command ended with {code}"


def in_shell(command: str, folder: Path) -> subprocess.CompletedProcess[str]:
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    environment = {**os.environ, "PATH": programs, "NO_COLOR": "1", "PYTHONUTF8": "1"}
    return subprocess.run(
        ["bash", "-c", command],
        cwd=folder,
        env=environment,
        capture_output=True,
        encoding="utf-8",
        timeout=120,
    )


def assert_target_exists(place: str, command: str) -> None:
    words = [word for word in command.partition("#")[0].split()[1:] if "=" not in word]
    if command.startswith("make ") and words:
        assert re.search(rf"^{words[0]}:", page("Makefile"), re.MULTILINE), (
            f"{place}: no target for {command!r}"
        )


def save_plant(block: Block, folder: Path) -> None:
    name = re.search(r"`([\w-]+\.toml)`", block.above)
    tables = tomllib.loads(block.text)
    if "plant" not in tables:
        return
    assert name, f"{block.place}: the line above names no file"
    path = folder / name[1]
    path.write_text(block.text, encoding="utf-8")
    assert load_suite(path).scenarios if "suite" in tables else Plant.load(path).n > 0


@pytest.mark.parametrize("name", PAGES)
def test_every_code_block_does_what_the_page_shows(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    namespace: dict[str, Any] = {"__name__": name}
    for block in blocks(name):
        assert block.language in LANGUAGES, f"{block.place}: a block of {block.language or 'no language'}"
        if block.language == "python":
            run_python(block, namespace)
        elif block.language in ("console", "bash"):
            run_commands(block, tmp_path)
        elif block.language == "toml":
            save_plant(block, tmp_path)


def test_every_fence_is_closed_and_read() -> None:
    for name in PAGES:
        fences = re.findall(r"^\s*```", page(name), re.MULTILINE)
        assert len(fences) == 2 * len(blocks(name)), name


def test_every_relative_link_leads_to_a_file_and_a_heading() -> None:
    for name in PAGES:
        text = FENCE.sub("", page(name))
        for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]*))?\)", text):
            file = (ROOT / name).parent / target if target else ROOT / name
            assert file.exists(), f"{name}: {target}"
            assert not anchor or anchor in headings(file), f"{name}: {target}#{anchor}"


def headings(file: Path) -> set[str]:
    """Anchors that GitHub makes of the headings."""
    titles = re.findall(r"^#+ (.*)$", FENCE.sub("", file.read_text(encoding="utf-8")), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


def test_every_make_target_that_is_named_exists() -> None:
    for name in PAGES:
        for command in re.findall(r"`(make [^`]+)`", page(name)):
            assert_target_exists(name, command)


def test_the_readme_lists_exactly_the_estimators_there_are() -> None:
    listed = set(re.findall(r"^\| `(\w+)\(", page("README.md"), re.MULTILINE))
    public = {name for name in securestate.__all__ if is_estimator(getattr(securestate, name))}
    assert listed == public


def is_estimator(thing: object) -> bool:
    return isinstance(thing, type) and issubclass(thing, Estimator) and thing is not Estimator


def test_the_folders_of_architecture_exist_and_every_package_folder_is_there() -> None:
    tree = next(block.text for block in blocks("ARCHITECTURE.md") if block.language == "text")
    folders = {line.split()[0] for line in tree.splitlines() if line and not line[0].isspace()}
    assert [entry for entry in folders if not (ROOT / entry).exists()] == []
    packages = {p.parent for p in (ROOT / "src/securestate").glob("*/__init__.py")}
    assert {f"{p.relative_to(ROOT)}/" for p in packages} <= folders


def test_the_changelog_has_a_section_for_this_version() -> None:
    version = tomllib.loads(page("pyproject.toml"))["project"]["version"]
    assert re.search(rf"^## \[{re.escape(version)}\]", page("CHANGELOG.md"), re.MULTILINE)


def test_the_tests_that_architecture_names_exist() -> None:
    for file, test in re.findall(r"`(tests/[\w/]+\.py)::(\w+)`", page("ARCHITECTURE.md")):
        functions = [node.name for node in ast.parse(page(file)).body if isinstance(node, ast.FunctionDef)]
        assert test in functions, f"{file}::{test}"


def test_the_papers_numbers_in_the_docs_are_those_of_its_reproduction() -> None:
    source = set(re.findall(r"[\d.]+", page("papers/liu2020/README.md")))
    rows = re.findall(r"^\| sensor \d \|(.*)\|$", page("docs/sparse-fusion.md"), re.MULTILINE)
    condition = re.findall(r"condition number is (\d+), in our basis ([\d.]+\d)", page("docs/decisions.md"))
    copied = {number.strip() for row in rows for number in row.split("|")} | set(condition[0])
    assert len(rows) == 5
    assert copied <= source
