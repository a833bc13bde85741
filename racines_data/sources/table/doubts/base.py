"""What a doubt is."""

from dataclasses import dataclass

from racines_data.sources.gate.bounds import READING


@dataclass(frozen=True)
class Doubt:
    """One thing that looks wrong with a mapping."""

    name: str
    """What the mistake is called, in a word or three: `millimetres`, `w first`, `transposed`."""
    field: str
    """The field of the mapping that is wrong."""
    detail: str
    """What was found."""
    remedy: str
    """What to write instead."""
    certain: bool = True
    """Whether no recording could be so; else it is an inference that can be allowed."""

    def __str__(self) -> str:
        allowed = "" if self.certain else f". If it is right as it is: --allow {READING}"
        return f"{self.field}: {self.name}: {self.detail}: {self.remedy}{allowed}"
