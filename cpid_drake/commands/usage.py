"""Commands as plain functions, whose annotations are their arguments and options.

The annotation of a parameter has its type; its form as in a line of usage, such as "LOG" or
"--out FILE", unless that is an option of the parameter's name; its group in the help, if it has
one; its help; and its limits, if there are some. A parameter that is a dataclass stands for its
fields.
"""

import inspect
from collections.abc import Callable
from dataclasses import fields, is_dataclass
from typing import Annotated, Any, get_args, get_type_hints

import typer


def group(text: str, **commands: Callable[..., Any]) -> typer.Typer:
    """Return a command of several commands by their names, with the help of the whole."""
    whole = typer.Typer(no_args_is_help=True, help=text)
    for name, command in commands.items():
        whole.command(name)(_as_typer_takes_it(command))
    return whole


def _as_typer_takes_it(command: Callable[..., Any]) -> Callable[..., Any]:
    """Return a command with one keyword for each argument and option."""
    hints = get_type_hints(command, include_extras=True)
    groups: dict[str, Any] = {name: kind for name, kind in hints.items() if is_dataclass(kind)}
    signature, parameters = inspect.signature(command), []
    for name, parameter in signature.parameters.items():
        own = get_type_hints(groups[name], include_extras=True) if name in groups else hints
        for each in fields(groups[name]) if name in groups else [parameter]:
            made = inspect.Parameter(each.name, inspect.Parameter.KEYWORD_ONLY)
            annotation = _for_typer(each.name, own[each.name])
            parameters.append(made.replace(default=each.default, annotation=annotation))

    def run(**values: Any) -> Any:
        for name, kind in groups.items():
            values[name] = kind(**{each.name: values.pop(each.name) for each in fields(kind)})
        return command(**values)

    run.__name__, run.__doc__ = command.__name__, command.__doc__
    run.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return run


def _for_typer(name: str, annotation: Any) -> Any:
    """Return a parameter's annotation as that of an argument or an option."""
    kind, *rest = get_args(annotation)
    limits = None if isinstance(rest[-1], str) else rest.pop()
    has_form = rest[0].startswith("--") or rest[0].isupper()
    form = rest.pop(0) if has_form else f"--{name.replace('_', '-')}"
    *panel, text = rest
    shown: dict[str, Any] = {"help": text.replace("[", "\\["), "rich_help_panel": (*panel, None)[0]}
    if limits is not None:
        shown |= {"min": limits.ge, "max": getattr(limits, "le", None)}
    if not form.startswith("--"):
        return Annotated[kind, typer.Argument(metavar=form, **shown)]
    flag, _, metavar = form.partition(" ")
    shown |= {"metavar": metavar or None, "show_default": "Default: " not in text}
    return Annotated[kind, typer.Option(flag, **shown)]
