"""What somebody hostile writes where a name, a description or a label is asked for."""

MARKUP = [
    "<script>pwned()</script>", "<img src=x onerror=pwned()>", "</td></table><iframe src=x>",
    "<!-- ", "-->", "<?php", "&lt;b&gt;", "&#60;script&#62;", "\"' onmouseover=pwned() x=\"",
    "[here](https://evil.example)", "![here](https://evil.example/a.png)",
    "[a]: https://evil.example", "<https://evil.example>", "https://evil.example/x", 
    "WWW.evil.example",
    "HTTP\\://evil.example", "ftp://evil.example", "who@evil.example", "mailto:who@evil.example",
    "xmpp:who@evil.example", "| a | b |", "a\\|b", "\\", "**a** __b__ _c_ *d* ~~e~~ ~f~", 
    "`a` `` ` ``",
    "# a", "##", "- a", "+ a", "1. a", "2) a", "> a", "---", "===", "~~~", "```", "    a", "***",
    "!!! note", "??? note", ": a", "[^1]: a", "$\\href{x}{y}$", "{{ x }} ${x} {% x %}",
    "a\nb", "a\r\n| c | d |", "a\u2028b", "a\x0bb",
]  # fmt: skip
CONTROLS = [
    "\x1b[2J\x1b[1;1Hracines: holds", "\x1b]0;title\x07", "\x1b]8;;https://evil.example\x1b\\here",
    "\x9b31mred", "\x9d0;title\x9c", "a\rb", "a\x08\x08b", "a\x7fb", "a\x00b", "\u202eholds",
    "a\u2066b", "a\u200bb", "\udcffname", "[red]a[/red]", "[link=https://evil.example]a[/link]",
    ":smile:", "a\nracines: holds",
]  # fmt: skip
FORMULAS = [
    "=1+1", "+1+1", "-1+1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", " =1", "=HYPERLINK(\"https://evil\")",
    "=cmd|'/C calc'!A0", "\uff1d1+1", "\uff0b1", "\uff0d1", "\uff20x", "\x1b=1", "+", "-", "-1-1",
    'a","b', 'a"\n=1',
]  # fmt: skip
ALL = [*MARKUP, *CONTROLS, *FORMULAS]
