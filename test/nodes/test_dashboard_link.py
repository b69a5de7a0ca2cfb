"""The dashboard as a participant of the graph."""

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus

from ehls_ros.nodes.dashboard_link import Link


def test_what_a_node_had_sent_when_it_was_ended_is_not_heard_later(participant):
    link = Link("ehls")
    try:
        publisher = participant.node.create_publisher(DiagnosticArray, "/diagnostics", 10)

        def report(*names):
            array = DiagnosticArray(status=[DiagnosticStatus(name=name, message="well", hardware_id="ehls") for name in names])
            array.header.stamp = participant.node.get_clock().now().to_msg()
            return array

        def heard():
            return [health.node for health in link.health()]

        def saying(array, node):
            publisher.publish(array)
            return node in heard()

        participant.until(lambda: saying(report("ended", "other"), "ended"))
        late = report("ended", "late")
        link.forget(["ended"])
        assert heard() == ["other"]
        participant.until(lambda: saying(late, "late"))
        assert heard() == ["late", "other"]
        # One of that name that is started again is heard.
        participant.until(lambda: saying(report("ended"), "ended"))
    finally:
        link.close()
