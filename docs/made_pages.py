"""Pages of the site that are made from code when it is built: the columns of a run's files, and the notebooks."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from deploy.record.columns import FILES

NOTEBOOKS = Path(__file__).parent / "notebooks"


def on_files(files: Files, config: Any) -> Files:
    """Add them; mkdocs calls this."""
    files.append(File.generated(config, "reference/files.md", content=files_page()))
    for notebook in sorted(NOTEBOOKS.glob("*.ipynb")):
        name = f"notebooks/{notebook.stem}.md"
        files.append(File.generated(config, name, content=notebook_page(notebook)))
    return files


def files_page() -> str:
    """The columns of all tables of a run directory."""
    lines = [
        "# Files of a run",
        "",
        "The [run directory](../architecture.md#the-run-directory) holds these tables beside maps, summary and "
        "capture. This page is made from `deploy/record/columns.py`, by which the files are written.",
    ]
    for file, columns in FILES.items():
        lines += ["", f"## {file}", "", "| column | type | |", "|---|---|---|"]
        lines += [f"| `{column.name}` | {column.type} | {column.meaning} |" for column in columns]
    return "\n".join(lines) + "\n"


def notebook_page(path: Path) -> str:
    """A notebook as a page: its text, and its code as blocks; outputs come with running it."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    pages = []
    for cell in cells:
        text = "".join(cell["source"])
        pages.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    pages.insert(1, f"This is the notebook `docs/notebooks/{path.name}`: open it in Jupyter to run it.")
    return "\n\n".join(pages) + "\n"
