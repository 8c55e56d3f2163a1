"""`hil studio`: a page in the browser for the stands and recordings of this folder."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from hil.cli.terminal import say
from hil.errors import WrongUse


def studio(
    port: Annotated[int, typer.Option(min=0, max=65535, help="Of the page, on 127.0.0.1; 0: any that is free.")] = 8455,
) -> None:
    """Open a page for this folder in the browser: check a stand, record, identify. The page starts hil's commands.

    Only this computer reaches the page, and only a browser that opens the printed link.
    """
    try:
        from hil.studio import server
    except ImportError as error:
        if not (error.name or "").startswith(("starlette", "uvicorn", "websockets")):
            raise
        raise WrongUse(f"the page needs {error.name}: pip install 'hil[studio]'") from None
    with server.bind(port) as bound:
        server.serve(bound, Path.cwd(), say)
