"""Damage: bytes flipped, cut, doubled and zeroed; words of a text exchanged for hostile ones."""

import re
from random import Random

HOSTILE = (
    "", " ", "0", "-0", "-1", "1e400", "-1e-400", "nan", "inf", "-inf", "1e308", "1e-308", "9" * 400, "9**9**9",
    "9**9**9 kg", "1" + "0" * 30, "0x10", "1_000", "1,5", "١٢", "--", "=", "=nes1.alpha", "=cmd|' /C calc'!A0", "ground",
    "base", "all", "unknown", "x:m1", "x:", ":m1", "force:base", "time", "m" * 300, "é" * 150, "$", "$x^2$", "$\\frac{", "\\",
    "'", '"', '"""', "[", "]", "[[", "{", "}", "{{ 7*7 }}", "</script>", 'x")+alert(1)+("', "\0",
    "\x1b[2J", "\u202e", "\ufeff", "\t", "\r", "\n", "#", "%s%s%n", "a/../b", "/dev/zero", "/dev/null", "NUL",
    "__import__('os')",
    "d.__class__", "lambda: 0", "(" * 300, "-" * 300 + "d", "abs(" * 200, "d**d**d", "d**(1e9)", "d**-1", "1/d", "sqrt(-1)",
    "exp(exp(exp(d)))", "sign(0*d)", "max(d)", "true", "null", "1979-05-27", "[1, [2, [3]]]", "kg", "m/s", "degC", "dB", "%",
)  # fmt: skip
_WORD = re.compile(r"[A-Za-z_][A-Za-z_0-9]*|[0-9]+(?:\.[0-9]+)?(?:e-?[0-9]+)?|\"[^\"\n]*\"|[^\s\w]")


def damaged_bytes(rng: Random, content: bytes) -> bytes:
    """A few changes of a binary file."""
    data = bytearray(content)
    for _ in range(rng.choice((1, 1, 1, 2, 4, 16))):
        if not data:
            break
        place = rng.randrange(len(data))
        match rng.randrange(7):
            case 0 | 1 | 2:
                data[place] ^= 1 << rng.randrange(8)
            case 3:
                data[place] = rng.choice((0, 255, 127, 128))
            case 4:
                del data[place:]
            case 5:
                del data[place : place + rng.randrange(1, 64)]
            case 6:
                data[place:place] = data[max(0, place - rng.randrange(1, 64)) : place]
    return bytes(data)


def damaged_text(rng: Random, text: str) -> str:
    """A few words exchanged, lines dropped, doubled or cut."""
    for _ in range(rng.choice((1, 1, 1, 2, 3))):
        words = list(_WORD.finditer(text))
        lines = text.split("\n")
        match rng.randrange(8):
            case 0 | 1 | 2 | 3 if words:
                word = rng.choice(words)
                text = text[: word.start()] + hostile(rng) + text[word.end() :]
            case 4 if words:
                first, second = rng.choice(words), rng.choice(words)
                text = text[: first.start()] + second[0] + text[first.end() :]
            case 5:
                del lines[rng.randrange(len(lines))]
                text = "\n".join(lines)
            case 6:
                lines.insert(rng.randrange(len(lines)), rng.choice(lines))
                text = "\n".join(lines)
            case _:
                text = text[: rng.randrange(len(text) + 1)]
    return text


def damaged_file(rng: Random, text: str, binary: float) -> bytes:
    """A text with words exchanged, and with a chance of `binary` its bytes changed too."""
    content = damaged_text(rng, text).encode("utf-8", "surrogatepass")
    return damaged_bytes(rng, content) if rng.random() < binary else content


def hostile(rng: Random) -> str:
    """A word that nobody means; at times a very long one."""
    word = rng.choice(HOSTILE)
    return word * 2000 if rng.random() < 0.02 else word
