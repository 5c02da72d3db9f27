"""The dashboard's picture in the docs: ``python -m tests.system.dashboard_picture docs/dashboard.png``."""

from __future__ import annotations

import io
import sys
import tempfile
from pathlib import Path

from PIL import Image

from deploy.dashboard.process import RECORDING
from deploy.dashboard.windows import Window
from deploy.run.exploration import explore
from deploy.scenario.scenario import parse
from tests.system.headless import settled_picture, viewer

BAR = 37
"""Rows of the viewer's own title bar, which is left out."""

STEP = 55
"""The step that is shown, in the middle of the run."""


def main() -> None:
    with tempfile.TemporaryDirectory() as folder:
        run = Path(folder, "run")
        explore(
            parse({"bus": "memory", "robots": 8, "range": "30%", "bandwidth": 50}),
            out=run,
            window=Window("file"),
        )
        with viewer(run / RECORDING) as client:
            picture = Image.open(io.BytesIO(settled_picture(client, STEP))).convert("RGB")
    picture = picture.crop((0, BAR, picture.width, picture.height))
    picture.quantize(256, dither=Image.Dither.NONE).save(sys.argv[1], optimize=True)


if __name__ == "__main__":
    main()
