"""The search for attacks: sequences closer to a violation are kept and mutated, deterministically."""

import itertools
import random

from guided import KEPT, LONGEST, Kind, Search

KINDS = {
    "push": Kind(1, lambda chance: (chance.random(),)),
    "pull": Kind(1, lambda chance: (chance.random(),)),
    **{f"idle_{number}": Kind(1) for number in range(8)},
}
"""Few of the actions matter, as on a rig."""


def robustness(attack):
    """Approach one policy by many strong pushes, another by pulls in succession; a third is indifferent."""
    pushes = sum(action.arguments[0] for action in attack if action.name == "push")
    pairs = sum(one.name == other.name == "pull" for one, other in itertools.pairwise(attack))
    return {"pushed": 6.0 - pushes, "pulled": 6.0 - pairs, "indifferent": 1.0, "unsaid": float("inf")}


def closest(seed, *, blind, sequences=400):
    search = Search(random.Random(seed), KINDS, blind=blind)
    for _ in range(sequences):
        attack = search.next()
        assert 1 <= len(attack) <= LONGEST
        search.learn(attack, robustness(attack))
    return search


def test_guided_attacks_come_closer_than_blind_ones():
    for seed in range(5):
        guided, blind = closest(seed, blind=False).closest, closest(seed, blind=True).closest
        nearer = [blind[policy][0].robustness - guided[policy][0].robustness for policy in ("pushed", "pulled")]
        assert min(nearer) > 0.0
        assert sum(nearer) > 2.0


def test_the_same_seed_and_the_same_answers_give_the_same_attacks():
    one, other = closest(7, blind=False), closest(7, blind=False)
    assert one.closest == other.closest
    assert one.origins == other.origins


def test_policies_that_depend_on_the_attack_take_turns():
    search = closest(3, blind=False)
    assert "unsaid" not in search.closest
    assert abs(search.origins["pushed"] - search.origins["pulled"]) <= 10
    assert search.origins["pushed"] > 100
    assert search.origins["indifferent"] == 0
    assert all(len(kept) <= KEPT for kept in search.closest.values())


def test_each_kind_of_action_begins_a_drawn_sequence_in_turn():
    search = Search(random.Random(1), KINDS, blind=True)
    assert {search.next()[0].name for _ in KINDS} == set(KINDS)
