"""A wizard's dialogue at a terminal."""

from collections.abc import Sequence

import typer


class TerminalDialogue:
    """Tells on stderr, asks with a prompt; Enter takes what is proposed."""

    def announce(self, text: str) -> None:
        """Print it."""
        typer.echo(text, err=True)

    def advance(self, stage: str, *, n_done: int, n_all: int) -> None:
        """Print how far it is, at the end of a stage; before, the questions say it."""
        if n_done == n_all:
            self.announce(f"{stage}s: {n_done} of {n_all}")

    def confirm(self, question: str) -> bool:
        """Ask for yes or no."""
        return typer.confirm(question, default=True, err=True)

    def choose(self, question: str, choices: Sequence[str]) -> str:
        """Ask for one of the words, or its beginning."""
        listed = ", ".join(choices)
        while True:
            answer: str = typer.prompt(f"{question}\n  {listed}?", default=choices[0], err=True)
            word = answer.strip().lower()
            matching = [choice for choice in choices if word and choice.startswith(word)]
            if len(matching) == 1:
                return matching[0]
            self.announce(f"  '{answer}': type one of {listed}")
