"""Draw the README's pictures of the reports anew: `python benchmarks/report_picture.py` (needs chromium).

The commands are those of the README's transcript, and the demonstration of a hand; a picture is what a browser shows of
their report.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from hil.cli.app import run

ROOT = Path(__file__).parent.parent
PICTURES = ROOT / "docs" / "pictures"
SIZES = {"report.png": "1000,1250", "hand.png": "1000,780"}  # pixels


def main() -> None:
    browser = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
    if browser is None:
        sys.exit("there is no chromium: apt-get install chromium")
    transcript = re.findall(r"^\$ hil ((?:record|identify) .+)$", (ROOT / "README.md").read_text("utf-8"), re.MULTILINE)
    for picture, commands in {"report.png": transcript, "hand.png": ["demo --hand"]}.items():
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            for command in commands:
                sys.argv = ["hil", *shlex.split(command)]  # the page names the command that made it
                run(sys.argv[1:])
            page = next(Path(folder).rglob("*.html"))
            words = ["--headless", "--no-sandbox", "--hide-scrollbars", f"--window-size={SIZES[picture]}"]
            words += [f"--screenshot={PICTURES / picture}", f"--user-data-dir={folder}/profile", page.as_uri()]
            subprocess.run([browser, *words], check=True, capture_output=True)


if __name__ == "__main__":
    main()
