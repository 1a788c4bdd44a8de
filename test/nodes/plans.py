"""Powers and plans for the energy node, and the way to ask it."""

from evpinn_ros import topics
from evpinn_ros.core.energy.power_model import Weather
from evpinn_ros.core.signals.readings import NANOSECONDS
from evpinn_ros.core.vehicle.files import load_vehicle
from evpinn_ros.nodes.factory import new_message
from evpinn_ros.topics.messages import header, named_vector

NOW = 1_700_000_000 * NANOSECONDS
VEHICLE = load_vehicle("tesla_model_3_lr")
WEATHER = Weather(VEHICLE.air_density)
ANSWERS = (topics.FORECAST, topics.FORECAST_BATTERY)


def power(stamp_ns, watts, sigma=100.0):
    return named_vector(new_message, stamp_ns, ["power"], [watts], [sigma])


def profile(*points, frame="plan 7"):
    """A speed profile of (s, m, m/s)."""
    return new_message(
        topics.TRAJECTORY_TYPE,
        header=header(new_message, NOW, frame),
        joint_names=["distance"],
        points=[
            new_message(
                "trajectory_msgs/msg/JointTrajectoryPoint",
                positions=[float(distance)],
                velocities=[float(speed)],
                time_from_start=new_message("builtin_interfaces/msg/Duration", sec=time),
            )
            for time, distance, speed in points
        ],
    )


def path(*points, stamps=None):
    """A path of (x, y, z)."""
    stamps = stamps or [0] * len(points)
    return new_message(
        topics.PATH_TYPE,
        header=header(new_message, NOW, "map"),
        poses=[
            new_message(
                "geometry_msgs/msg/PoseStamped",
                header=header(new_message, stamp * NANOSECONDS, "map"),
                pose=new_message(
                    "geometry_msgs/msg/Pose",
                    position=new_message("geometry_msgs/msg/Point", x=x, y=y, z=z),
                ),
            )
            for (x, y, z), stamp in zip(points, stamps, strict=True)
        ],
    )


TRIP = ((0, 0, 0), (20, 150, 15), (120, 1650, 15), (140, 1800, 0))


def ask(bench, node, topic, message):
    """Send a plan; give the answers, which are published before the node counts it."""
    for answer in ANSWERS:
        bench.heard[answer].clear()
    expected, plans = dict(node.published), node.plans
    done = plans.answered + plans.refused
    bench.deliver(node, topic, message)
    bench.pump(lambda: plans.answered + plans.refused > done)
    expected = {answer: node.published[answer] - expected.get(answer, 0) for answer in ANSWERS}
    bench.pump(lambda: all(len(bench.heard[answer]) == expected[answer] for answer in ANSWERS))
    return bench.heard[topics.FORECAST], bench.heard[topics.FORECAST_BATTERY]
