"""How the Studio looks: one calm theme without fonts from elsewhere, and a little CSS."""

from pathlib import Path

from gradio.themes import Base
from gradio.themes.utils import colors, sizes

MUTED, PAPER, ACCENT = "#56626d", "#f6f8f9", "#24527a"
SYSTEM = ("system-ui", "-apple-system", "Segoe UI", "Roboto", "sans-serif")
MONO = ("ui-monospace", "SFMono-Regular", "Menlo", "monospace")


def theme() -> Base:
    """Return the theme: slate and blue, hairlines, no shadows."""
    base = Base(
        primary_hue=colors.blue,
        neutral_hue=colors.slate,
        radius_size=sizes.radius_sm,
        font=SYSTEM,
        font_mono=MONO,
    )
    return base.set(
        body_background_fill=PAPER,
        body_background_fill_dark="#12171c",
        body_text_color_subdued=MUTED,
        body_text_color_subdued_dark="#9aa7b2",
        block_shadow="none",
        block_label_text_weight="500",
        button_primary_background_fill=ACCENT,
        button_primary_background_fill_hover="#2f6a9d",
        button_primary_background_fill_dark="#2f6a9d",
        button_primary_text_color="white",
        slider_color=ACCENT,
    )


CSS = Path(__file__).with_name("studio.css").read_text()
HEAD = """<header><h1>RACINES Studio</h1>
<p>The open benchmark for robotic cardiac ultrasound.</p></header>"""
FOOT = """<footer><p><strong>Research software, not a medical device.</strong>
Simulated images say so.</p></footer>"""
