"""The help texts of the commands: names of types, examples, and exit statuses."""

from __future__ import annotations

import re
from types import MappingProxyType
from typing import Any

from typer.core import TyperCommand

EXAMPLES = MappingProxyType(
    {
        "record": (
            "hil record --backend sim --profile chirp -o run1.h5",
            "hil record --stand stand.toml --profile multisine --band 0.5:20 --duration 30 -o run2.h5",
        ),
        "identify": (
            "hil identify run1.h5 --report run1.html",
            "hil identify run1.h5 run2.h5 --model linear+offset+coulomb --json",
        ),
        "hysteresis": (
            "hil hysteresis ramp1.h5 ramp2.h5 --report ramps.html",
            "hil hysteresis weights.csv --part 0:7N*m --part 7:50N*m --lost-motion 1N*m",
        ),
        "compare": ("hil compare monday.h5 tuesday.h5 friday.h5 --report week.html",),
        "report": ("hil report monday.h5 tuesday.h5 friday.h5 -o week.html",),
        "inspect": ("hil inspect run1.h5",),
        "view": ("hil view run1.h5", "hil view run1.h5 -o run1.rrd"),
        "import": (
            "hil import log.csv --time time_s --torque tau --torque-unit mN*m --dtheta q --dtheta-unit deg -o log.h5",
            "hil import bag --topic /joint_states --joint finger -o bag.h5",
        ),
        "export": ("hil export run1.h5 -o run1.csv", "hil export run1.h5 -o finger.xml"),
        "recover": ("hil recover run1.h5.part",),
        "campaign": ("hil campaign examples/hand.toml --dry-run",),
        "hand": ("hil hand hand.toml --dry-run", "hil hand hand.toml"),
        "demo": ("hil demo",),
        "studio": ("hil studio", "hil studio --port 0"),
        "replicate": ("hil replicate --trials 5 --evaluations 200000",),
        "design": ("hil design --stand stand.toml --kc 0.02 --bc 2e-4 --duration 30",),
        "emulate": ("hil emulate dynamixel --link ./ttyDXL --log torque.csv",),
        "doctor": ("hil doctor", "hil doctor stand.toml --move"),
        "stand new": ("hil stand new -o stand.toml", "hil stand new --scan /dev/ttyUSB0 -o hand.toml"),
        "stand schema": ("hil stand schema",),
        "calibrate torque": ("hil calibrate torque stand.toml --arm 50mm",),
        "calibrate fixture": ("hil calibrate fixture stand.toml --profile chirp --band 0.5:20",),
        "calibrate zero": ("hil calibrate zero stand.toml",),
    }
)
"""Example command lines for each command, printed below its help."""

STATUSES = (
    "0: done",
    "1: done, and the result must not be trusted",
    "2: wrong use; nothing was changed",
    "3: the stand or the drive failed",
    "4: a limit was reached; the torque is off and the rows are kept",
    "70: hil itself failed (EX_SOFTWARE); neither the request nor the data is the cause",
    "130: interrupted with Ctrl-C (128 + the number of any other signal)",
)
"""The meaning of each exit status."""


def below_help(command: str) -> str:
    """Return the text below the help of a command; \\b keeps its lines as they are."""
    return "\b\nExamples:\n" + "\n".join(f"  {line}" for line in EXAMPLES[command])


def below_main_help() -> str:
    """Return the text below the help of `hil`."""
    return "\b\nExit status:\n" + "\n".join(f"  {line}" for line in STATUSES)


class Command(TyperCommand):
    """A typer command whose help shows <path> instead of Python's types, such as <list[Path]>."""

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, the options, and each group of rarely needed options under its heading."""
        groups: dict[str, list[tuple[str, str]]] = {}
        for param in self.get_params(ctx):
            if (shown := param.get_help_record(ctx)) is not None:
                usual = "Arguments" if param.param_type_name == "argument" else "Options"
                groups.setdefault(getattr(param, "rich_help_panel", None) or usual, []).append(shown)
        for heading in sorted(groups, key=lambda name: name not in {"Arguments", "Options"}):
            with formatter.section(heading):
                formatter.write_dl(groups[heading])

    def get_help(self, ctx: Any) -> str:
        """Return the help. ctx: typer's context."""
        return re.sub(r"<list\[(\w+)\]>", lambda found: f"<{found[1].lower()}>", super().get_help(ctx))
