"""Damage specific to YAML: wrong types, duplicate keys, aliases, bombs, tags, depth, other files."""

from __future__ import annotations

import itertools
import re
from collections.abc import Callable

import mutations_bytes
import numpy as np

VALUES = (
    *(
        "null",
        "~",
        "",
        "true",
        "no",
        "0",
        "-1",
        "1e400",
        "-1e400",
        ".nan",
        ".inf",
        "1e-3",
        "0x1F",
        "0o17",
        "0b1",
        "1_000",
    ),
    *(
        "9" * 30,
        "9" * 5000,
        "1" + "0" * 400,
        "1e" + "9" * 50,
        "12:30:45",
        "2001-12-14",
        "2001-99-99",
        "[]",
        "{}",
        "[[]]",
    ),
    *(
        "[1, 2]",
        "[1, 2, 3, 4]",
        "{a: 1}",
        "{? [a, b] : c}",
        "? a",
        "|",
        ">",
        "|9",
        "'",
        '"',
        '"\\0"',
        '"\\ud800"',
        '"\\x07"',
    ),
    *('"../../../etc/passwd"', '"/dev/zero"', '"/dev/stdin"', '"/dev/tty"', '"~nobody-here/x"', '"."', '".."', '"/"'),
    *(
        '"a\\0b.c3d"',
        '"' + "x" * 5000 + '"',
        '"' + "a/" * 3000 + '"',
        "!!python/object:os.system [x]",
        "!!int x",
        "!!int ''",
    ),
    *(
        "!!float x",
        "!!bool maybe",
        "!!binary ===",
        "!!null x",
        "!!set {a, b}",
        "!!omap [a: 1]",
        "!!timestamp x",
        "!x y",
    ),
    *(
        "!!str",
        "!!map []",
        "!!seq {}",
        "!<tag:yaml.org,2002:int> z",
        "&a [*a]",
        "&a {b: *a}",
        "*nowhere",
        "<<",
        "%",
        "@x",
        "`x",
    ),
    *(
        "- 1",
        "ü",
        "\u2028",
        "\x85",
        "\ufeff",
        "\x07",
        "𝟙",
        "CON",
        "..",
        "trial.c3d",
        "fifo",
        "loop",
        "folder",
        "socket",
        "big",
    ),
)
LINES = (
    "<<: {trial: x}",
    "<<: *nowhere",
    "--- ",
    "...",
    "%YAML 1.1",
    "%YAML 9.9",
    "%TAG ! tag:x,2000:",
    "? [a, b]\n: c",
    "? {a: b}\n: c",
    "'': 1",
    "null: 1",
    "1: 2",
    "true: 1",
    "__class__: x",
    "model_config: {}",
    "\t tab: 1",
    "trial: twice",
    "recording: twice.c3d",
    "segment: {count: 99999999999999999999}",
    "window: [.nan, .inf]",
    "window: [1e400, 2]",
    "plates: {feet: [0, -1, 1e99], seat: [1]}",
    "external: [{file: fifo, name: hand, segment: 1, at: [0, 0, .nan]}]",
    "external: [{file: /dev/zero, name: hand, segment: 1, at: B1}]",
    "compare: {angles: /dev/zero, columns: {a: b}}",
    "encoder: /dev/zero\nprotocol: robot-joint",
)


def bomb(rng: np.random.Generator) -> str:
    """Return a bomb of nested aliases (billion laughs)."""
    names = "abcdefghi"
    lines = [f"{names[0]}: &{names[0]} [lol, lol, lol, lol, lol, lol, lol, lol, lol]"]
    lines += [f"{new}: &{new} [{', '.join([f'*{old}'] * 9)}]" for old, new in itertools.pairwise(names)]
    return "\n".join(lines)


def deep(rng: np.random.Generator) -> str:
    depth = int(rng.choice([10, 100, 330, 990, 1010, 5000, 100_000]))
    opening, closing = (("[", "]"), ("{a: ", "}"), ("- ", ""), ("? ", ""), ("&a ", ""), ("!t ", ""))[rng.integers(6)]
    return f"deep: {opening * depth}{closing * depth if rng.random() < 0.5 else ''}"


def wide(rng: np.random.Generator) -> str:
    count = int(rng.choice([100, 5000, 60_000]))
    kind = int(rng.integers(4))
    if kind == 0:
        return "wide: [" + "1," * count + "]"
    if kind == 1:
        return "wide: {" + ",".join(f"k{k}" for k in range(min(count, 20_000))) + "}"
    if kind == 2:
        return "\n".join(f"key{k}: 1" for k in range(min(count, 5000)))
    return "long: " + "x" * count


def value(text: str, rng: np.random.Generator) -> str:
    """Replace a value."""
    found = list(re.finditer(r"(?m)(?<=: ).+$|(?<=- ).+$", text))
    if not found:
        return text
    match = found[rng.integers(len(found))]
    return text[: match.start()] + VALUES[rng.integers(len(VALUES))] + text[match.end() :]


def line(text: str, rng: np.random.Generator) -> str:
    lines = text.split("\n")
    lines.insert(int(rng.integers(len(lines) + 1)), LINES[rng.integers(len(LINES))])
    return "\n".join(lines)


def shuffle(text: str, rng: np.random.Generator) -> str:
    lines = text.split("\n")
    k, other = int(rng.integers(len(lines))), int(rng.integers(len(lines)))
    what = int(rng.integers(4))
    if what == 0:
        del lines[k]
    elif what == 1:
        lines.insert(k, lines[other])
    elif what == 2:
        lines[k], lines[other] = lines[other], lines[k]
    else:
        lines[k] = " " * int(rng.integers(8)) + lines[k].lstrip()
    return "\n".join(lines)


def large(text: str, rng: np.random.Generator) -> str:
    made = (bomb, deep, wide)[rng.integers(3)](rng)
    return f"{text}\n{made}\n" if rng.random() < 0.6 else f"{made}\n{text}"


def key(text: str, rng: np.random.Generator) -> str:
    found = list(re.finditer(r"\b[\w-]+(?=:)", text))
    if not found:
        return text
    match = found[rng.integers(len(found))]
    new = ("", "x", match[0].upper(), match[0] + "s", "'a b'", "[a]", "? x", "<<", "ü" * 200, "&k " + match[0])
    return text[: match.start()] + new[rng.integers(len(new))] + text[match.end() :]


KINDS: tuple[Callable[[str, np.random.Generator], str], ...] = (value, value, value, line, line, shuffle, large, key)
ENDS = ((b"\n", b"\r\n"), (b"\n", b"\r"), (b" ", b"\t"), (b"\n", b"\n\x00"), (b": ", b":"), (b"  ", b" "))


def apply(data: bytearray, rng: np.random.Generator) -> None:
    for _ in range(int(rng.integers(1, 4))):
        text = bytes(data).decode("utf-8", "replace")
        data[:] = KINDS[rng.integers(len(KINDS))](text, rng).encode("utf-8", "replace")
    chance = rng.random()
    if chance < 0.1:
        mutations_bytes.apply(data, rng, 1)
    elif chance < 0.2:
        data[:] = bytes(data).replace(*ENDS[rng.integers(len(ENDS))])
    elif chance < 0.25:
        code = str(rng.choice(["utf-16", "utf-8-sig", "latin-1", "utf-32"]))
        data[:] = bytes(data).decode("utf-8", "replace").encode(code, "replace")
