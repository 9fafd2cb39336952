"""``rcbht completion``."""

from __future__ import annotations

import dataclasses
import re
import typing
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import tyro

from rcbht_jax.cli.command import Command
from rcbht_jax.errors import InputError

COMMON = {"--help": (), "--json": ()}
TOP: dict[str, tuple[str, ...]] = {"--help": (), "--version": ()}
Shell = Literal["bash", "zsh", "fish"]


@dataclass(frozen=True)
class Completion(Command):
    """Print the script that completes commands, options and their values in a shell.

    For bash, write it to ~/.local/share/bash-completion/completions/rcbht.

    For zsh, write it to ~/.rcbht.zsh and add "source ~/.rcbht.zsh" to ~/.zshrc, after compinit.

    For fish, write it to ~/.config/fish/completions/rcbht.fish.

    Example: rcbht completion bash
    """

    shell: Annotated[Shell, tyro.conf.Positional]
    """Shell to complete in."""

    def run(self) -> dict[str, Any]:
        from rcbht_jax.cli.main import all_commands, command_class

        table = {name: COMMON | options_of(command_class(name)) for name in all_commands()}
        summaries = {name: summary for name, (_, summary) in all_commands().items()}
        script = _fish(table, summaries) if self.shell == "fish" else _bash(table, self.shell == "zsh")
        return {"shell": self.shell, "script": script}

    def text(self, result: dict[str, Any]) -> str:
        return result["script"].rstrip()


Options = dict[str, tuple[str, ...]]  # option -> its values, where they are a fixed set


def options_of(command: type[Command]) -> Options:
    """The options of a command, and what each may be where it is one of a fixed set."""
    hints = typing.get_type_hints(command, include_extras=True)
    options: Options = {}
    for field in dataclasses.fields(command):
        hint, name = hints[field.name], field.name.replace("_", "-")
        extras = hint.__metadata__ if typing.get_origin(hint) is Annotated else ()
        if tyro.conf.Positional in extras:
            continue
        options[f"--no-{name}" if field.default is True else f"--{name}"] = _choices(hint)
    return options


def of_several_values(command: type[Command]) -> set[str]:
    """The options of a command that take any number of values."""
    hints = typing.get_type_hints(command, include_extras=True)
    return {f"--{name.replace('_', '-')}" for name, hint in hints.items() if _has_tuple(hint)}


def check_numbers(command: type[Command], words: list[str], complaint: str) -> None:
    """Refuse other words where options take numbers, of those options that a complaint about the words names.

    Raises:
        InputError: such a word, with the option and what it takes.
    """
    hints = typing.get_type_hints(command, include_extras=True)
    options = {f"--{name.replace('_', '-')}": hint for name, hint in hints.items()}
    kinds = {option: kind for option, hint in options.items() if option in complaint and (kind := _number(hint))}
    several, option = of_several_values(command), ""
    for word in words:
        value = word
        if re.match("--|-[a-z]$", word):
            option, equals, value = word.partition("=")
            option = option.replace("_", "-")
            if not equals:
                continue
        try:
            kinds.get(option, str)(value)
        except ValueError:
            what = "a whole number" if kinds[option] is int else "a number"
            raise InputError(f"{option} is {value!r}; expected {what}.") from None
        option = option if option in several else ""


def _number(hint: Any) -> type | None:
    """The type of number that an option takes, also within a tuple or a union."""
    if hint in (int, float):
        return hint
    return next(filter(None, map(_number, typing.get_args(hint))), None)


def _has_tuple(hint: Any) -> bool:
    return typing.get_origin(hint) is tuple or any(map(_has_tuple, typing.get_args(hint)))


def _choices(hint: Any) -> tuple[str, ...]:
    """The strings of a Literal, also within a tuple or a union."""
    if typing.get_origin(hint) is Literal:
        return tuple(map(str, typing.get_args(hint)))
    return tuple(word for part in typing.get_args(hint) for word in _choices(part))


def _children(table: dict[str, Options]) -> dict[str, list[str]]:
    """The words that may follow those typed so far: {"": ["info", "plot", ...], "plot": ["trial", "map", ...]}."""
    children: dict[str, list[str]] = {}
    for name in table:
        words = name.split()
        for count, word in enumerate(words):
            following = children.setdefault(" ".join(words[:count]), [])
            following.extend([word] if word not in following else [])
    return children | {"completion": list(typing.get_args(Shell))}


def _bash(table: dict[str, Options], zsh: bool) -> str:
    """One function; zsh runs it by its emulation of bash's completion. Other words are completed as files."""
    children = _children(table)
    commands = "|".join(f'"{name}"' for name in dict.fromkeys([*children, *table]) if name)
    values = {
        f"{name} {option}": choices for name, options in table.items() for option, choices in options.items() if choices
    }
    head = "autoload -U +X bashcompinit && bashcompinit\n" if zsh else ""
    return f"""{head}_rcbht() {{
  local current="${{COMP_WORDS[COMP_CWORD]}}" command="" option="" words="" word
  for word in "${{COMP_WORDS[@]:1:$((COMP_CWORD - 1))}}"; do
    case "$word" in
    -*) option="$word" ;;
    *) [ -z "$option" ] && _rcbht_is_command "${{command:+$command }}$word" && command="${{command:+$command }}$word" ;;
    esac
  done
  case "$current" in
  -*) case "$command" in
{_cases({"": TOP, **table})}    esac ;;
  *) case "$command${{option:+ $option}}" in
{_cases(children)}{_cases(values)}    esac ;;
  esac
  COMPREPLY=($(compgen -W "$words" -- "$current"))
}}
_rcbht_is_command() {{
  case "$1" in
  {commands}) return 0 ;;
  esac
  return 1
}}
complete -o default -F _rcbht rcbht
"""


def _cases(words: Mapping[str, Iterable[str]]) -> str:
    return "".join(f'    "{typed}") words="{" ".join(following)}" ;;\n' for typed, following in words.items())


def _fish(table: dict[str, Options], summaries: dict[str, str]) -> str:
    """Conditions on the command typed so far, which a function finds; files where a command takes no further word."""
    children = _children(table)
    commands = " ".join(f"'{name}'" for name in dict.fromkeys([*children, *table]) if name)
    lines = []
    for typed, following in children.items():
        for word in following:
            summary = summaries.get(f"{typed} {word}".strip(), "").replace("'", "\\'")
            lines.append(f"complete -c rcbht -f -n '__rcbht_is \"{typed}\"' -a '{word}' -d '{summary}'")
    for name, options in {"": TOP, **table}.items():
        for option, choices in options.items():
            values = f" -x -a '{' '.join(choices)}'" if choices else ""
            lines.append(f"complete -c rcbht -n '__rcbht_is \"{name}\"' -l {option[2:]}{values}")
    return f"""function __rcbht_is
  set -l typed
  for word in (commandline -opc)[2..-1]
    string match -q -- '-*' $word; and break
    set -l longer (string join ' ' $typed $word)
    contains -- $longer {commands}; and set typed $longer
  end
  test "$typed" = "$argv[1]"
end
""" + "".join(f"{line}\n" for line in lines)
