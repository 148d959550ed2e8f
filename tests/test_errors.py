"""The error tree: every code has a class, a meaning and a remedy."""

import pickle  # noqa: TID251 - what worker processes do with an error

import pytest

from msb.errors import EXIT_STATUS, AssetError, UsageError, error_finding, explained_codes


def test_classes_and_explanations_know_the_same_codes() -> None:
    registered = [code for kind in EXIT_STATUS for code in kind.codes]
    assert sorted(registered) == sorted(explained_codes())
    assert all(code.summary.endswith(".") and code.remedy for code in explained_codes().values())


def test_a_code_belongs_to_one_class() -> None:
    with pytest.raises(TypeError, match="USAGE"):
        AssetError("USAGE", "text")


def test_an_error_keeps_what_it_says_on_its_way() -> None:
    error = AssetError("TRIASSET_FIELD", "text", pointer="/version")
    assert str(error.at("a.triasset")) == "TRIASSET_FIELD: a.triasset: text"
    for other in (pickle.loads(pickle.dumps(error)), error_finding(error).to_error(None)):
        assert (type(other), str(other), other.pointer) == (AssetError, str(error), "/version")
    assert UsageError("USAGE", "line\nbreak").message == r"line\nbreak"
