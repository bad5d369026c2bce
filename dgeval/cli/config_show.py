"""dgeval config show: every parameter with its value and meaning."""

from __future__ import annotations

from typing import Annotated, Any

import typer

from dgeval.cli.boundary import command, print_json

app = typer.Typer(help="Parameters of the pipelines.", no_args_is_help=True)


@app.callback()
def main() -> None:
    """Parameters of the pipelines."""


@app.command(
    "show",
    epilog="`dgeval config show --set fusion.n_s=3 > mine.toml` makes a file for `--pipeline`.",
)
@command
def show(
    pipeline: Annotated[
        str, typer.Option(help="dynamic, handover, vfas, or a FILE.toml.")
    ] = "dynamic",
    set_: Annotated[list[str] | None, typer.Option("--set", help="section.key=value.")] = None,
    json_: Annotated[bool, typer.Option("--json", help="JSON instead of TOML.")] = False,
) -> None:
    """Print the resolved configuration as TOML that `--pipeline` takes; parameters without a value
    as comments."""
    from dgeval.config import load_config

    config = load_config(pipeline, tuple(set_ or ()))
    if json_:
        print_json(config.model_dump(mode="json"))
        return
    top: list[str] = []
    sections: list[str] = []
    _render(config, "", top, sections)
    typer.echo("\n".join([*top, *sections]))


def _render(node: Any, path: str, lines: list[str], sections: list[str]) -> None:
    import json

    from pydantic import BaseModel

    for name, field in type(node).model_fields.items():
        value = getattr(node, name)
        key = f"{path}.{name}" if path else name
        if isinstance(value, BaseModel):
            inner: list[str] = ["", f"[{key}]"]
            nested: list[str] = []
            _render(value, key, inner, nested)
            sections += inner + nested if len(inner) > 2 else nested
            continue
        text = f"# {name} =" if value is None else f"{name} = {json.dumps(value)}"
        lines.append(f"{text}  # {field.description}" if field.description else text)
