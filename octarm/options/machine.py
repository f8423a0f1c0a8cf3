"""What the commands are asked for that concern the machine."""

from __future__ import annotations

import dataclasses
from typing import Annotated

from octarm.options.argument import Operand


@dataclasses.dataclass(frozen=True)
class Doctor:
    """Say what this machine has for octarm, and what to install.

    Versions, processor, graphics, folders. Everything is tried out rather than looked up. Exit code
    0 when octarm run works here, even if pictures or films do not, 1 when it does not.

    Examples:
      octarm doctor
    """


@dataclasses.dataclass(frozen=True)
class Completion:
    """Print a script by which a shell completes commands.

    Commands, options, names of controllers and references, files and folders.

    Examples:
      octarm completion bash >> ~/.bashrc
      octarm completion zsh >> ~/.zshrc
      octarm completion fish > ~/.config/fish/completions/octarm.fish
    """

    shell: Annotated[str, Operand("SHELL", "the shell")]
