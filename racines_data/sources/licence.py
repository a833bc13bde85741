"""Licence and consent that a user states at import, and where they are written down.

Both are the user's word, kept as such: they enter the card of the dataset's source, which the
manifest holds, and from there the dataset's card, Croissant and the exports.
"""

from dataclasses import replace
from typing import Any

from racines_data.errors import RacinesError
from racines_data.sources.base import SourceCard, own_card

UNKNOWN = "unknown"
HUB = {
    *("apache-2.0", "mit", "bsd-2-clause", "bsd-3-clause", "gpl-3.0", "odc-by", "odbl", "pddl"),
    *("cc0-1.0", "cc-by-4.0", "cc-by-sa-4.0", "cc-by-nc-4.0", "cc-by-nd-4.0", "cc-by-nc-sa-4.0"),
    *("cc-by-nc-nd-4.0", UNKNOWN, "other"),
}
"""Licences that a hub knows by a name."""
WARNING = (
    "no licence given: the card says `unknown`, and nobody may assume that anything is permitted; "
    "state it with --licence, and with --consent that those who were scanned agreed"
)
_LONGEST = 1000


def asks(source: Any) -> bool:
    """Return whether a source reads recordings whose licence only the user knows."""
    return bool(getattr(source, "of_users", False))


def declared_card(source: Any, licence: str = "", consent: str = "") -> SourceCard | None:
    """Return the card that a dataset has to hold itself, with what its user declares; or None.

    Args:
        source: The source, with its own `card`.
        licence: An SPDX name such as `CC-BY-4.0`, or words; empty where nothing was said.
        consent: A statement on consent and review; empty where nothing was said.

    Raises:
        RacinesError: the source states a licence itself, or a text is too long.
    """
    for name, text in (("licence", licence), ("consent", consent)):
        if len(text) > _LONGEST or not text.isprintable():
            raise RacinesError(f"--{name}: give one line of at most {_LONGEST} characters")
    licence, consent = licence.strip(), consent.strip()
    card = getattr(source, "card", None) or SourceCard()
    if not asks(source) and not licence and not consent:
        return own_card(source)
    if licence and not asks(source) and card.license not in ("other", UNKNOWN):
        raise RacinesError(f"--licence: source {source.name} is {card.license}: leave it out")
    return replace(card, **_rights(card, licence, asks(source)), **_personal(card, consent))


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


def _personal(card: SourceCard, consent: str) -> dict[str, str]:
    said = f"Consent, as declared at import: {consent}" if consent else ""
    said = said or "No statement on consent was given at import."
    return {"personal": f"{card.personal} {said}"}
