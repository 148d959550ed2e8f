"""Bad texts by name, with their fuzz target, content, and error code."""

Bad = tuple[str, bytes, str]

_GATES: dict[str, bytes] = {
    "infinity": b"components>inf",
    "no number": b"components>x",
    "unknown key": b"componets>1",
    "long key": b"a" * 9000 + b">1",
    "code": b"__import__('os')",
}

BAD: dict[str, Bad] = {f"gate: {name}": ("gate", content, "USAGE") for name, content in _GATES.items()}
