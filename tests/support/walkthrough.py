"""Does what the tutorial or a page tells a reader to do, in an empty folder, and compares what the commands print.

python -m tests.support.walkthrough                      # docs/tutorial page by page; exit status 1 where one is wrong
python -m tests.support.walkthrough --pictures           # and writes their pictures into docs/images
python -m tests.support.walkthrough PAGE.md PAGE.md#part # these pages, or the part of a page below a heading

A page is read as a person reads it:

- "Save as `FILE`:" and a block: a file is written;
- "Change `A` to `B` in `FILE`" and "Copy `A` to `B`": done;
- an indented line that begins with `sim-heating` or `python -m pytest`, up to one without a backslash at its end: a
  command, which must succeed;
- an indented `export NAME=VALUE`: a variable of the environment of all later commands;
- a block of text after a command: each line of it has to be in what the command printed; `...` stands for more;
- a comment `<!-- picture: PATH -->`: the picture after it is a copy of this file.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from tests.support.paths import AIRCRAFT, ROOT, SCENARIOS

TUTORIAL = ROOT / "docs" / "tutorial"
STEP = re.compile(
    r"Save as `(?P<file>[^`]+)`:\n+```\w*\n(?P<content>.*?)^```"
    r"|[Cc]hange\s`(?P<old>[^`]+)`\sto\s`(?P<new>[^`]+)`\sin\s`(?P<changed>[^`]+)`"
    r"|[Cc]opy\s`(?P<source>[^`]+)`\sto\s`(?P<copy>[^`]+)`"
    r"|^    (?P<command>(?:sim-heating|python -m pytest|export) (?:[^\n]*\\\n)*[^\n]*)$"
    r"|^```text\n(?P<output>.*?)^```"
    r"|<!-- picture: (?P<picture>\S+) -->\s*!\[[^\]]*\]\((?P<image>[^)]+)\)",
    re.MULTILINE | re.DOTALL,
)


@dataclass
class Walk:
    """One reader in a folder of their own."""

    folder: Path
    pictures: bool = False
    printed: str = ""
    commands: int = 0
    environment: dict[str, str] = field(default_factory=lambda: {**os.environ, "PYTHONPATH": str(ROOT)})

    def follow(self, page: Path, part: str = "") -> Iterator[str]:
        """Do what a page, or the part below one of its headings, says, in its order; yields what is wrong."""
        text = page.read_text()
        start, end = span(text, part)
        for step in STEP.finditer(text, start, end):
            line = text.count("\n", 0, step.start()) + 1
            try:
                self.do(step, page)
            except (AssertionError, OSError) as error:
                yield f"{page.relative_to(ROOT)}, line {line}: {error}"

    def do(self, step: re.Match[str], page: Path) -> None:
        """Do one step."""
        if step["file"]:
            (self.folder / step["file"]).parent.mkdir(parents=True, exist_ok=True)
            (self.folder / step["file"]).write_text(step["content"])
        elif step["changed"]:
            path = self.folder / step["changed"]
            content = path.read_text()
            assert content.count(step["old"]) == 1, f"{step['changed']} has {step['old']!r} not once"
            path.write_text(content.replace(step["old"], step["new"]))
        elif step["copy"]:
            shutil.copy(self.folder / step["source"], self.folder / step["copy"])
        elif step["command"]:
            self.run(step["command"])
        elif step["output"]:
            shown = [words(line) for line in step["output"].splitlines() if line.strip() not in ("", "...")]
            missing = [line for line in shown if line not in words(self.printed)]
            assert not missing, f"not printed: {missing[0]!r}; the command printed\n{self.printed}"
        else:
            made, image = self.folder / step["picture"], (page.parent / step["image"]).resolve()
            assert made.is_file(), f"{step['picture']} was not written"
            if self.pictures:
                shutil.copy(made, image)
            assert image.is_file(), f"no picture {step['image']}; write it with --pictures"

    def run(self, command: str) -> None:
        """Run a command and keep what it prints; set a variable for those that follow."""
        start = time.perf_counter()
        first, *arguments = shlex.split(command.replace("\\\n", " "), comments=True)
        self.commands += 1
        if first == "export":
            self.environment |= {name: value for name, _, value in (a.partition("=") for a in arguments)}
            return
        program = ["-m", "sim_heating"] if first == "sim-heating" else []
        done = subprocess.run(
            [sys.executable, *program, *arguments],
            cwd=self.folder,
            capture_output=True,
            text=True,
            env=self.environment,
        )
        self.printed = done.stdout + done.stderr
        print(f"{time.perf_counter() - start:6.1f} s  {command}", flush=True)
        assert done.returncode == 0, f"{command}: exit status {done.returncode}\n{self.printed}"


def words(text: str) -> str:
    """Text without the lines of tables and with single spaces, as a terminal of any width shows it."""
    return " ".join(re.sub(r"[\u2500-\u257f|]", " ", text).split())


def span(text: str, part: str) -> tuple[int, int]:
    """Where the part of a page below a heading begins and ends; the whole page without a heading.

    part : the heading as links name it, `a-form-of-your-own`
    """
    headings = [(m.start(), m[1]) for m in re.finditer(r"^#+ (.+)$", text, re.MULTILINE)] if part else [(0, "")]
    anchors = [re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-") for _, title in headings]
    assert part in anchors, f"no heading #{part}"
    ends = [start for start, _ in headings[1:]] + [len(text)]
    return headings[anchors.index(part)][0], ends[anchors.index(part)]


def main(arguments: list[str]) -> int:
    """Follow the tutorial or the pages of the command line; exit status."""
    pictures, named = "--pictures" in arguments, [a for a in arguments if a != "--pictures"]
    if not named:
        return follow_all([(page, "") for page in sorted(TUTORIAL.glob("[0-9]*.md"))], pictures)
    parts = [name.partition("#") for name in named]
    return max(follow_all([(Path(page).resolve(), part)], pictures) for page, _, part in parts)


def follow_all(pages: list[tuple[Path, str]], pictures: bool) -> int:
    """Follow pages, or parts of them, one after the other in one folder; exit status."""
    start = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(SCENARIOS, Path(folder, "scenarios"))
        shutil.copytree(AIRCRAFT, Path(folder, "aircraft_data"))
        walk = Walk(Path(folder), pictures)
        wrong = [fault for page, part in pages for fault in walk.follow(page, part)]
    minutes = (time.perf_counter() - start) / 60.0
    names = ", ".join(str(page.relative_to(ROOT)) for page, _ in pages)
    print("\n".join(wrong) or f"{names}: {walk.commands} commands, {minutes:.1f} minutes; all works as it is written")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
