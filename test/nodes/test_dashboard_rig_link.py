"""The monitor's messages arrive on the dashboard, and its button reaches the monitor."""

import math
from concurrent.futures import ThreadPoolExecutor

import pytest

pytest.importorskip("ehls_msgs.msg._model_health", reason="needs ehls_msgs built, as `make setup` does")

from builtin_interfaces.msg import Time
from std_srvs.srv import Trigger

from ehls_msgs.msg import ModelChange, ModelHealth, TrackedCoefficient
from ehls_ros.nodes import dashboard_rig
from ehls_ros.nodes.dashboard_link import Link
from ehls_ros.nodes.transport import control_qos
from ehls_ros.recording.topics import MODEL_HEALTH

NAME = "leakage_coefficient"


def said(second: int, value: float, *, told: bool = True) -> ModelHealth:
    coefficient = TrackedCoefficient(name=NAME, unit="m^5/(N s)", value=value, deviation=1e-13, told=told)
    changes = [ModelChange(sentence=f"change {number}", active=True) for number in (1, 2)]
    message = ModelHealth(state=ModelHealth.WATCHING, summary="all is well", changes=changes, coefficients=[coefficient])
    message.header.stamp = Time(sec=second)
    return message


def test_the_health_is_heard_with_its_trend_and_is_gone_with_the_monitor(participant):
    publisher = participant.node.create_publisher(ModelHealth, MODEL_HEALTH.name, control_qos(1))
    publisher.publish(said(100, 4e-12))
    link = Link("ehls")
    try:
        # Messages from before it joined arrive too.
        participant.until(lambda: link.rig_health() is not None)
        publisher.publish(said(160, 0.0, told=False))
        participant.until(lambda: len(link.rig_health().coefficients[0].times) == 2)
        publisher.publish(said(220, 5e-12))
        participant.until(lambda: len(link.rig_health().coefficients[0].times) == 3)
        health = link.rig_health()
        assert (health.state, health.summary) == ("watching", "all is well")
        assert [change.sentence for change in health.changes] == ["change 2", "change 1"]
        [coefficient] = health.coefficients
        assert coefficient.times == (100.0, 160.0, 220.0)
        assert [coefficient.values[0], coefficient.values[2]] == [4e-12, 5e-12]
        assert math.isnan(coefficient.values[1])
        participant.node.destroy_publisher(publisher)
        participant.until(lambda: link.rig_health() is None)
    finally:
        link.close()


def test_acknowledging_reaches_the_monitor(participant):
    asked = []

    def answer(request, response):
        asked.append(request)
        response.success, response.message = True, "1 changes"
        return response

    participant.node.create_service(Trigger, "monitor_acknowledge", answer)
    link = Link("ehls")
    try:
        pressed = []
        with ThreadPoolExecutor(1) as pool:

            def answered():
                # It waits for some seconds; DDS may take longer to find the service, or lose the answer.
                if not pressed or (pressed[-1].done() and not pressed[-1].result().done):
                    pressed.append(pool.submit(link.acknowledge_changes))
                return pressed[-1].done() and pressed[-1].result().done

            participant.until(answered)
        assert pressed[-1].result() == (True, "1 changes")
        assert 1 <= len(asked) <= len(pressed)
    finally:
        link.close()


def test_a_clock_that_goes_back_begins_a_new_trend(participant):
    watch = dashboard_rig.RigWatch(participant.node)
    try:
        for second in (100, 160, 160, 5, 10):
            watch._register(said(second, 4e-12))
        assert list(watch._past[NAME]) == [(5.0, 4e-12), (10.0, 4e-12)]
    finally:
        watch.destroy()
