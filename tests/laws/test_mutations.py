"""The test of the tests: a tracer that is damaged on purpose breaks the law that the damage offends."""

import pytest
from damages import DAMAGES
from transport_laws import LAWS

pytestmark = pytest.mark.slow


@pytest.mark.parametrize("law", LAWS, ids=lambda law: law.__name__)
def test_the_laws_hold_for_the_tracer_as_it_is(law):
    law()


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.name)
def test_damage_is_seen(damage, monkeypatch):
    damage.inflict(monkeypatch)
    with pytest.raises((AssertionError, ArithmeticError)) as seen:
        damage.law()
    assert seen.type in (AssertionError, ArithmeticError), "a crash is not a law"


def test_no_law_is_idle():
    assert {damage.law for damage in DAMAGES} == set(LAWS)
