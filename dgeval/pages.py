"""Templates and embedded figures for the pages of a report and of a comparison."""

from __future__ import annotations

import base64
import io

import jinja2
from matplotlib.figure import Figure


def template_environment(folder: str) -> jinja2.Environment:
    """Templates of a folder in the package; HTML is escaped."""
    return jinja2.Environment(
        loader=jinja2.PackageLoader("dgeval", folder),
        autoescape=jinja2.select_autoescape(["html"]),
        trim_blocks=True,
        lstrip_blocks=True,
    )


def as_data_uri(figure: Figure) -> str:
    """A figure as a PNG data URI, so that the HTML file needs no other file."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110, metadata={"Software": None})
    return "data:image/png;base64," + base64.b64encode(buffer.getvalue()).decode()
