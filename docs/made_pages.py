"""Pages that are made from the code: files of a run, messages, packets (`python -m docs.made_pages` writes them).

The notebooks become pages when the site is built.
"""

from __future__ import annotations

import inspect
import json
from pathlib import Path
from typing import Any

from mkdocs.structure.files import File, Files

from deploy.record.columns import FIELD, FILES, RECORDED, SUMMARY
from docs import packet_tables
from protocol import messages
from protocol.rights import RIGHTS

NOTEBOOKS = Path(__file__).parent / "notebooks"


def on_files(files: Files, config: Any) -> Files:
    """Add the pages of the notebooks; mkdocs calls this hook."""
    for notebook in sorted(NOTEBOOKS.glob("*.ipynb")):
        name = f"notebooks/{notebook.stem}.md"
        files.append(File.generated(config, name, content=notebook_page(notebook)))
    return files


def on_page_markdown(markdown: str, **_: Any) -> str:
    """Let links to notebooks lead to their pages; mkdocs calls this hook."""
    return markdown.replace(".ipynb)", ".md)")


def files_page() -> str:
    """Return a page with the columns of all tables of a run directory."""
    lines = [
        "# Files of a run",
        "",
        "A [run directory](../architecture.md#the-run-directory) contains these tables and a summary, besides "
        "maps and capture. `deploy/record/columns.py` defines them.",
    ]
    for file, columns in FILES.items():
        lines += ["", f"## {file}", "", "| column | type | meaning |", "|---|---|---|"]
        lines += [f"| `{column.name}` | {column.type} | {column.meaning} |" for column in columns]
    for title, keys in (
        ("## summary.json", SUMMARY),
        ("[Recorded runs](../recorded.md) also have:", RECORDED),
        ("[Robots in the field](../field.md#records) also have:", FIELD),
    ):
        lines += ["", title, "", "| key | meaning |", "|---|---|"]
        lines += [f"| {key} | {meaning} |" for key, meaning in keys.items()]
    return "\n".join(lines) + "\n"


def messages_page() -> str:
    """Return a page with number, fields, and description of each message, and the rights to send them."""
    lines = [
        "# Messages",
        "",
        "The messages of the [bus](../bus.md), as defined in `protocol/messages.py`.",
        "",
        "| no. | message | fields | meaning |",
        "|---|---|---|---|",
    ]
    for number, kind in enumerate(messages.TYPES):
        meaning = " ".join((inspect.getdoc(kind) or "").split()).replace("|", r"\|")
        lines.append(f"| {number} | `{kind.__name__}` | {', '.join(kind.__struct_fields__)} | {meaning} |")
    lines += ["", "## Rights", "", "| sender | receiver | messages |", "|---|---|---|"]
    for (sender, receiver), kinds in RIGHTS.items():
        lines.append(f"| {sender} | {receiver} | {', '.join(f'`{kind.__name__}`' for kind in kinds)} |")
    return "\n".join(lines) + "\n"


def packets_page() -> str:
    """Return a page with the fields of all packets."""
    return f"# Packet fields\n\nThe letters of the [layouts](../protocol.md#packets):\n\n{packet_tables.fields()}"


def notebook_page(path: Path) -> str:
    """Return a notebook as a page with its text and code, without outputs."""
    cells = json.loads(path.read_text(encoding="utf-8"))["cells"]
    pages = []
    for cell in cells:
        text = "".join(cell["source"])
        pages.append(text if cell["cell_type"] == "markdown" else f"```python\n{text}\n```")
    pages.insert(1, f"Open the notebook `docs/notebooks/{path.name}` in Jupyter to run it.")
    return "\n\n".join(pages) + "\n"


REFERENCE = {"files.md": files_page, "messages.md": messages_page, "packets.md": packets_page}
"""The pages in ``docs/reference`` that are made from the code."""


def main() -> None:
    """Write the pages of `REFERENCE`."""
    for name, page in REFERENCE.items():
        (Path(__file__).parent / "reference" / name).write_text(page(), encoding="utf-8")


if __name__ == "__main__":
    main()
