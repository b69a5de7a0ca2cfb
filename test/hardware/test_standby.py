"""Standby controllers and their names."""

import pytest

from ehls_ros.errors import BadInput
from ehls_ros.hardware.standby import Standby

SIC, FASMC, OTHER = "/ehls/sic_node-17", "/ehls/fasmc_node-4", "/ehls/fasmc_node-5"


@pytest.fixture
def standby():
    made = Standby(patience=10)
    made.cycle = 100
    for sender in (SIC, FASMC):
        made.hear(sender, 100)
    return made


@pytest.mark.parametrize("name", ["sic_node", "/ehls/sic_node", SIC])
def test_a_controller_is_found_by_any_of_its_names(standby, name):
    assert standby.named(name) == SIC


@pytest.mark.parametrize("name", ["", "node", "ic_node", "sic", "/other/sic_node", "sic_node-18"])
def test_another_name_is_refused_with_those_that_stand_by(standby, name):
    with pytest.raises(BadInput, match=f"does not stand by.*{FASMC}, {SIC}"):
        standby.named(name)


def test_two_of_one_name_need_the_process(standby):
    standby.hear(OTHER, 100)
    with pytest.raises(BadInput, match=f"several controllers.*{FASMC}, {OTHER}"):
        standby.named("fasmc_node")
    assert standby.named(OTHER) == OTHER


def test_one_that_left_or_is_late_stands_by_no_more(standby):
    standby.forget(SIC)
    assert standby.ready == [FASMC]
    standby.cycle = 110
    assert (standby.ready, standby.behind) == ([FASMC], [FASMC])
    standby.cycle = 111
    assert standby.ready == []
