"""Messages that other stacks send, over real DDS: CAN frames and Autoware."""

import pytest

from evpinn_ros.common.errors import InputError
from evpinn_ros.nodes.can_bridge import CanBridgeNode
from evpinn_ros.nodes.factory import is_installed


def test_frames_speed_and_plans_of_others(run_with_messages):
    run_with_messages("others_check.py")


@pytest.mark.skipif(is_installed("can_msgs"), reason="can_msgs is installed here")
def test_frames_of_a_topic_without_their_messages_are_refused(bench):
    with pytest.raises(InputError, match="the package can_msgs is not installed"):
        bench.start(CanBridgeNode, interface="can_msgs", channel="from_can_bus")


def test_a_topic_of_frames_cannot_be_asked(bench):
    options = {"interface": "can_msgs", "vehicle": "bmw_i3", "poll": True}
    with pytest.raises(InputError, match="a topic of frames answers no requests"):
        bench.start(CanBridgeNode, **options)
