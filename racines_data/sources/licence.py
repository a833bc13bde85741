"""Licence, consent and origin that a user states at import, and where they are written down.

All are the user's word, kept as such: they enter the card of the dataset's source, which the
manifest holds, and from there the dataset's card, Croissant and the exports.
"""

import re
from dataclasses import replace
from typing import Any

from racines_data.errors import RacinesError
from racines_data.sources.base import SourceCard, is_own, own_card

UNKNOWN = "unknown"
HUB = {
    *("apache-2.0", "mit", "bsd-2-clause", "bsd-3-clause", "gpl-3.0", "odc-by", "odbl", "pddl"),
    *("cc0-1.0", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc-by-nd-4.0", "cc-by-nc-sa-4.0"),
    *("cc-by-nc-nd-4.0", UNKNOWN, "other"),
}
"""Licences that a hub knows by a name."""
_LEFT_OUT = {
    "licence": "no licence given, and nobody may assume that anything is permitted (--licence)",
    "consent": "no statement that those who were scanned agreed (--consent)",
    "origin": "no origin given, and nobody is credited with the recordings (--origin)",
}
_LONGEST = 1000


def asks(source: Any) -> bool:
    """Return whether a source reads recordings whose licence only the user knows."""
    return bool(getattr(source, "of_users", False))


def left_out(source: Any, licence: str = "", consent: str = "", origin: str = "") -> str:
    """Return a line on what nobody said of recordings, with the options; empty if all is said."""
    card = getattr(source, "card", None) or SourceCard()
    said = {
        "licence": licence or not asks(source),
        "consent": consent or not asks(source),
        "origin": origin or card.attribution or is_own(card, getattr(source, "name", "")),
    }
    lacking = "; ".join(told for name, told in _LEFT_OUT.items() if not said[name])
    return lacking and f"{lacking}: the card says so"


def credited(maker: str) -> tuple[str, str]:
    """Return name and address of `authors, URL`; where there is but an address, it is the name."""
    found = re.search(r"https?://\S+", maker)
    if not found:
        return maker, ""
    url = found[0].rstrip(".,;)>")
    name = " ".join(f"{maker[: found.start()]} {maker[found.end() :]}".split()).strip(" ,;()<>")
    return name or url, url


def declared_card(
    source: Any, licence: str = "", consent: str = "", origin: str = ""
) -> SourceCard | None:
    """Return the card that a dataset has to hold itself, with what its user declares; or None.

    Args:
        source: The source, with its own `card`.
        licence: An SPDX name such as `CC-BY-4.0`, or words; empty where nothing was said.
        consent: A statement on consent and review; empty where nothing was said.
        origin: Who made the recordings and where they are published; likewise.

    Raises:
        RacinesError: the source states a licence or a maker itself, or a text is too long.
    """
    for name, text in (("licence", licence), ("consent", consent), ("origin", origin)):
        if len(text) > _LONGEST or not text.isprintable():
            raise RacinesError(f"--{name}: give one line of at most {_LONGEST} characters")
    licence, consent, origin = licence.strip(), consent.strip(), origin.strip()
    card = getattr(source, "card", None) or SourceCard()
    if not asks(source) and not licence and not consent and not origin:
        return own_card(source)
    if licence and not asks(source) and card.license not in ("other", UNKNOWN):
        raise RacinesError(f"--licence: source {source.name} is {card.license}: leave it out")
    if origin and (card.attribution or is_own(card, source.name)):
        raise RacinesError(f"--origin: source {source.name} says itself whose it is: leave it out")
    rights, asked = _rights(card, licence, asks(source)), asks(source)
    return replace(
        card, **rights, **_personal(card, consent, asked), **_made_by(card, origin, asked)
    )


def _rights(card: SourceCard, licence: str, asked: bool) -> dict[str, str]:
    if licence:
        name = licence.lower() if licence.lower() in HUB else "other"
        return {"license": name, "rights": f"{licence}, as declared at import."}
    if not asked:
        return {}
    rights = (
        "Unknown: no licence was given at import. Nothing may be assumed to be permitted: ask "
        "whoever holds the rights."
    )
    limits = f"The licence of these frames is unknown. {card.limits}"
    return {"license": UNKNOWN, "rights": rights, "limits": limits}


def _personal(card: SourceCard, consent: str, asked: bool) -> dict[str, str]:
    if not consent and not asked:
        return {}
    said = f"Consent, as declared at import: {consent}" if consent else ""
    said = said or "No statement on consent was given at import."
    return {"personal": f"{card.personal} {said}"}


def _made_by(card: SourceCard, origin: str, asked: bool) -> dict[str, str]:
    if not origin and not asked:
        return {}
    said = f"Origin, as declared at import: {origin}" if origin else ""
    said = said or "No origin was given at import: who made the recordings is not known here."
    return {"attribution": origin, "collection": f"{card.collection} {said}"}
