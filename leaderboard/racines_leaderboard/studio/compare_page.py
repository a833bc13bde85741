"""Images side by side as HTML."""

from collections.abc import Sequence

from PIL import Image

from racines_leaderboard.studio.compare import Card
from racines_leaderboard.studio.escape import text
from racines_leaderboard.studio.pictures import element
from racines_leaderboard.studio.scene_page import quick_png

CSS = """
.rg-cards { display: grid; gap: .6rem;
  grid-template-columns: repeat(auto-fill, minmax(min(165px, 47%), 1fr)); }
.rg-card { margin: 0; background: #000; border-radius: 6px; overflow: hidden; }
.rg-card img { width: 100%; height: auto; display: block; }
.rg-card figcaption { padding: .4rem .55rem .5rem; background: #1a2026; color: #e6e9ec;
  font-size: .8rem; line-height: 1.4; font-variant-numeric: tabular-nums; min-height: 100%; }
.rg-card b { display: block; font-size: .9rem; color: #fff; overflow-wrap: anywhere; }
.rg-card span { display: block; color: #aab4bd; }
"""


def cards_page(cards: Sequence[Card]) -> str:
    """Return all cards as one grid, as many side by side as there is room for."""
    return f'<div class="rg-cards">{"".join(_card(card) for card in cards)}</div>'


def _card(card: Card) -> str:
    image = element(quick_png(Image.fromarray(card.image)), f"image by {card.title}", "")
    notes = "".join(f"<span>{text(note)}</span>" for note in card.notes)
    caption = f"<figcaption><b>{text(card.title)}</b>{notes}</figcaption>"
    return f'<figure class="rg-card">{image}{caption}</figure>'
