"""All that was found, weighed together."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from zeroshop_steps.register.scene.record import DuplicateStructure, Evidence, Fault, Finding, Inconsistent, Record, RegistrationFailed
from zeroshop_steps.register.verification import verdict
from zeroshop_steps.register.verification.verdict import MAX_WRONG_PROBABILITY, MEASURES, MOST_STRENGTH, judge, verify

NAMES = sorted(MEASURES)
strengths = st.dictionaries(st.sampled_from(NAMES), st.floats(0, 5))


@pytest.fixture
def common_weights(monkeypatch):
    """Each measure convinces alone at strength 1."""
    monkeypatch.setattr(verdict, "load_weights", lambda: (dict.fromkeys(MEASURES, 4.0), -4.0, 4.0))


def find(**strengths):
    return tuple(Finding(name, value, f"{name} found", (f"{name}.png",)) for name, value in strengths.items())


@given(strengths, st.sampled_from(NAMES), st.floats(0, 3))
def test_what_more_speaks_against_cameras_never_makes_them_likelier(known, name, more):
    worse = {**known, name: known.get(name, 0.0) + more}
    assert judge(find(**worse)).wrong >= judge(find(**known)).wrong - 1e-12


@pytest.mark.parametrize("name", NAMES)
def test_each_measure_convinces_alone_where_it_is_strong(name):
    assert judge(find(**{name: 0.3})).wrong < 0.1
    found = judge(find(**{name: MOST_STRENGTH}))
    assert found.wrong > MAX_WRONG_PROBABILITY and found.kind is MEASURES[name].kind
    assert f"{name} found" in found.reason and MEASURES[name].remedy in found.reason


def test_nothing_found_is_no_reason_to_doubt():
    assert judge(()).wrong < 0.1 and judge(()).kind is RegistrationFailed


def test_several_weak_findings_convince_together(common_weights):
    alone = max(judge(find(**{name: 0.9})).wrong for name in ("contradicted", "error", "photometry", "silhouettes"))
    found = judge(find(contradicted=0.9, error=0.9, photometry=0.9, silhouettes=0.9))
    assert found.wrong > MAX_WRONG_PROBABILITY > alone


def test_of_one_measure_the_strongest_counts():
    twice = (*find(error=0.2), *find(error=0.8))
    assert judge(twice) == judge(find(error=0.8))


def test_checks_are_asked_until_one_convinces(common_weights):
    record = verify(
        Record(), [lambda: Evidence({"one": 1}, find(error=0.3)), lambda: Evidence({"two": 2}, find(cut=0.2))], None, MAX_WRONG_PROBABILITY
    )
    assert record.entries["one"] == 1 and record.entries["two"] == 2
    said = record.entries["verdict"]
    assert said["wrong_probability"] < 0.1 and {"measure": "error", "strength": 0.3, "found": "error found"} in said["findings"]
    convincing = lambda: Evidence({"one": 1}, find(photometry=3.0))  # noqa: E731
    with pytest.raises(DuplicateStructure, match="photometry found") as error:
        verify(Record(), [convincing, lambda: pytest.fail("asked for nothing")], None, MAX_WRONG_PROBABILITY)
    assert error.value.figures["one"] == 1 and error.value.figures["verdict"]["wrong_probability"] > MAX_WRONG_PROBABILITY


def test_what_was_found_before_counts_too(common_weights):
    record = verify(Record(), [lambda: Evidence(findings=find(contradicted=0.8, error=0.8))], None, MAX_WRONG_PROBABILITY)
    with pytest.raises(Inconsistent, match="contradicted found"):
        verify(record, [lambda: Evidence(findings=find(silhouettes=0.8))], None, MAX_WRONG_PROBABILITY)
    verify(Record(), [lambda: Evidence(findings=find(silhouettes=0.8))], None, MAX_WRONG_PROBABILITY)


def test_a_lower_threshold_refuses_what_the_usual_one_accepts(common_weights):
    check = lambda: Evidence(findings=find(error=0.9))  # noqa: E731
    wrong = verify(Record(), [check], None, MAX_WRONG_PROBABILITY).entries["verdict"]["wrong_probability"]
    assert 0.1 < wrong < MAX_WRONG_PROBABILITY
    with pytest.raises(Inconsistent, match="error found"):
        verify(Record(), [check], None, 0.1)


def test_a_fault_needs_no_verdict():
    with pytest.raises(Inconsistent, match="no lens does"):
        verify(Record(), [lambda: Evidence(fault=Fault("no lens does", Inconsistent))], None, MAX_WRONG_PROBABILITY)
