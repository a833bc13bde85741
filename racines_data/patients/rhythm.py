# pyright: strict
"""When a heart beats and a chest breathes: from seconds to phases.

A patient's beats are written down once, as a tape that repeats: their lengths vary by the patient,
some come early and are followed by a pause, and in flutter all differ. Systole hardly shortens when
a beat does; what is lost is filling (Weissler et al., Circulation 1968).
"""

from typing import NamedTuple

import torch
from torch import Tensor

from racines_data.patients.draws import exact_normal
from racines_data.patients.motion import SYSTOLE
from racines_data.patients.patient import Motion
from racines_data.randomness import derive, uniform

BEATS = 64
"""Beats of a tape, about a minute."""


class Rhythm(NamedTuple):
    """Of K patients, float64 seconds."""

    starts: Tensor  # (K, BEATS + 1) of each beat, from 0 to the tape's end
    breath: Tensor  # (K,) of a breath


def rhythm_of(motion: Motion, seed: int) -> list[Tensor]:
    """Return the fields of one patient."""
    own = derive(torch.tensor([seed]), 907)
    mean = 60.0 / motion.rate
    length = mean * (1.0 + motion.variation * exact_normal(own, BEATS, 1)[0].clamp(-2.0, 2.0))
    early = uniform(own, BEATS, 2)[0] < motion.early
    pause = early.roll(1) & ~early
    length = length * torch.where(early, 0.62, torch.where(pause, 1.32, 1.0)).double()
    starts = torch.cat([length.new_zeros(1), length.round(decimals=6).cumsum(0)])
    return [starts, torch.tensor(motion.breath, dtype=torch.float64)]


def phases(rhythm: Rhythm, rows: Tensor, time: Tensor, hold: bool) -> Tensor:
    """Return (B, 2) cardiac and respiratory phases in [0, 1) of rows at (B,) seconds.

    Args:
        rhythm: of all patients.
        rows: (B,) which of them.
        time: float64; any start will do, since tapes repeat.
        hold: the breath is held, breathed out.
    """
    starts, time = rhythm.starts.index_select(0, rows), time.double()
    now = torch.remainder(time, starts[:, -1]).unsqueeze(1)
    beat = (torch.searchsorted(starts, now, right=True) - 1).clamp(0, BEATS - 1)
    since = (now - starts.gather(1, beat)).squeeze(1)
    length = (starts.gather(1, beat + 1) - starts.gather(1, beat)).squeeze(1)
    systole = torch.minimum(0.45 * length, 0.21 + 0.11 * length)
    contracting = SYSTOLE * since / systole
    filling = SYSTOLE + (1.0 - SYSTOLE) * (since - systole) / (length - systole)
    cardiac = torch.where(since < systole, contracting, filling).clamp(0.0, 1.0 - 1e-9)
    breath = torch.remainder(time / rhythm.breath.index_select(0, rows), 1.0)
    return torch.stack([cardiac, torch.zeros_like(breath) if hold else breath], 1)
