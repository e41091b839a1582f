"""Commands, run to their end as a person would type them."""

from __future__ import annotations

import os
import subprocess
import sys

from softwave_min.data import ROOT


def command(*arguments, folder=ROOT, **environment):
    """What a command printed and its exit status."""
    return subprocess.run(
        [str(argument) for argument in arguments],
        cwd=folder,
        env={**os.environ, **{name: str(value) for name, value in environment.items()}},
        capture_output=True,
        text=True,
        check=False,
        timeout=300,
    )


def python(code, *, interpreter=sys.executable, **options):
    """What Python prints on a piece of code, which must not fail."""
    answer = command(interpreter, "-c", code, **options)
    assert answer.returncode == 0, answer.stderr
    return answer.stdout
