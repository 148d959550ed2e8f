"""Error classes: every code has a class, an explanation and a remedy."""

import pickle  # noqa: TID251 - worker processes pickle errors

import pytest

from msb.errors import EXIT_STATUS, AssetError, UsageError, error_finding, explained_codes


def test_classes_and_explanations_have_the_same_codes() -> None:
    registered = [code for kind in EXIT_STATUS for code in kind.codes]
    assert sorted(registered) == sorted(explained_codes())
    assert all(code.summary.endswith(".") and code.remedy for code in explained_codes().values())


def test_a_code_belongs_to_one_class() -> None:
    with pytest.raises(TypeError, match="USAGE"):
        AssetError("USAGE", "text")


def test_errors_survive_pickling_and_conversion() -> None:
    error = AssetError("TRIASSET_FIELD", "text", pointer="/version")
    assert str(error.at("a.triasset")) == "TRIASSET_FIELD: a.triasset: text"
    for other in (pickle.loads(pickle.dumps(error)), error_finding(error).to_error(None)):
        assert (type(other), str(other), other.pointer) == (AssetError, str(error), "/version")
    assert UsageError("USAGE", "line\nbreak").message == r"line\nbreak"
