"""Does what the tutorial tells a reader to do, in an empty folder, and compares what the commands print.

python -m tests.support.walkthrough              # docs/tutorial page by page; exit status 1 where one is wrong
python -m tests.support.walkthrough --pictures   # and writes their pictures into docs/images

A page is read as a person reads it:

- "Save as `FILE`:" and a block: a file is written;
- "Change `A` to `B` in `FILE`" and "Copy `A` to `B`": done;
- an indented line that begins with `sim-heating`: a command, which must succeed;
- a block of text after a command: each line of it has to be in what the command printed; `...` stands for more;
- a comment `<!-- picture: PATH -->`: the picture after it is a copy of this file.
"""

from __future__ import annotations

import re
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.support.paths import AIRCRAFT, ROOT, SCENARIOS

TUTORIAL = ROOT / "docs" / "tutorial"
STEP = re.compile(
    r"Save as `(?P<file>[^`]+)`:\n+```\w*\n(?P<content>.*?)^```"
    r"|[Cc]hange\s`(?P<old>[^`]+)`\sto\s`(?P<new>[^`]+)`\sin\s`(?P<changed>[^`]+)`"
    r"|[Cc]opy\s`(?P<source>[^`]+)`\sto\s`(?P<copy>[^`]+)`"
    r"|^    (?P<command>sim-heating [^\n]*)$"
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

    def follow(self, page: Path) -> Iterator[str]:
        """Do what a page says, in its order; yields what is wrong."""
        text = page.read_text()
        for step in STEP.finditer(text):
            line = text.count("\n", 0, step.start()) + 1
            try:
                self.do(step, page)
            except (AssertionError, OSError) as error:
                yield f"{page.relative_to(ROOT)}, line {line}: {error}"

    def do(self, step: re.Match[str], page: Path) -> None:
        """Do one step."""
        if step["file"]:
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
            assert not missing, f"not printed: {missing[0]!r}"
        else:
            made, image = self.folder / step["picture"], (page.parent / step["image"]).resolve()
            assert made.is_file(), f"{step['picture']} was not written"
            if self.pictures:
                shutil.copy(made, image)
            assert image.is_file(), f"no picture {step['image']}; write it with --pictures"

    def run(self, command: str) -> None:
        """Run a command of the program and keep what it prints."""
        start = time.perf_counter()
        arguments = shlex.split(command, comments=True)[1:]
        done = subprocess.run(
            [sys.executable, "-m", "sim_heating", *arguments],
            cwd=self.folder, capture_output=True, text=True,
        )  # fmt: skip
        self.printed = done.stdout + done.stderr
        print(f"{time.perf_counter() - start:6.1f} s  {command}", flush=True)
        assert done.returncode == 0, f"{command}: exit status {done.returncode}\n{self.printed}"


def words(text: str) -> str:
    """Text without the lines of tables and with single spaces, as a terminal of any width shows it."""
    return " ".join(re.sub(r"[\u2500-\u257f|]", " ", text).split())


def main(pictures: bool) -> int:
    """Follow the tutorial; exit status."""
    with tempfile.TemporaryDirectory() as folder:
        shutil.copytree(SCENARIOS, Path(folder, "scenarios"))
        shutil.copytree(AIRCRAFT, Path(folder, "aircraft_data"))
        walk = Walk(Path(folder), pictures)
        wrong = [fault for page in sorted(TUTORIAL.glob("[0-9]*.md")) for fault in walk.follow(page)]
    print("\n".join(wrong) or "the tutorial works as it is written")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main("--pictures" in sys.argv[1:]))
