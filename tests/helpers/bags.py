"""ROS bags written by `rosbags`, with joint states."""

from pathlib import Path
from typing import Any

import numpy as np

JOINTS = ("up", "down")
_START = 1_700_000_000 * 10**9


def write_bag(
    folder: Path,
    kind: str,
    time: np.ndarray,
    position: np.ndarray,
    velocity: np.ndarray,
    effort: np.ndarray,
    *,
    gripper: bool = False,
    ragged: int | None = None,
    base: np.ndarray | None = None,
    packed: str | None = None,
) -> Path:
    """Write a bag of kind db3, mcap, folder or ros1; it was recorded at half the speed.

    With `packed`, a mode of compression, the folder is returned.

    With `base`, rows of position, quaternion x y z w, linear and angular velocity, every second
    state has an odometry and an IMU that measures the angular velocity.
    """
    from rosbags.rosbag1 import Writer as Writer1
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
    from rosbags.rosbag2 import Writer as Writer2
    from rosbags.typesys import Stores, get_typestore

    one = kind == "ros1"
    store = get_typestore(Stores.ROS1_NOETIC if one else Stores.ROS2_HUMBLE)
    state: Any = store.types["sensor_msgs/msg/JointState"]
    header: Any = store.types["std_msgs/msg/Header"]
    stamp: Any = store.types["builtin_interfaces/msg/Time"]
    pack = store.serialize_ros1 if one else store.serialize_cdr
    plugin = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    others: dict[str, Any] = {}
    file = folder.with_suffix(".bag") if one else folder
    writer: Any = Writer1(file) if one else Writer2(file, version=9, storage_plugin=plugin)
    if packed is not None:
        writer.set_compression(CompressionMode[packed], CompressionFormat.ZSTD)
    with writer as out:
        where = out.add_connection("/joint_states", state.__msgtype__, typestore=store)

        def write(k: int, names: tuple[str, ...], *rows: np.ndarray) -> None:
            when = _START + round(time[k] * 1e9)
            extra = {"seq": k} if one else {}
            head = header(stamp=stamp(when // 10**9, when % 10**9), frame_id="", **extra)
            message = state(head, list(names), *rows)
            recorded = _START + round(2.0 * time[k] * 1e9)
            out.write(where, recorded, pack(message, state.__msgtype__))

        for k in range(len(time)):
            # Drivers may name the joints in any order.
            turn = slice(None, None, -1 if k % 3 == 2 else 1)
            rows = [np.ascontiguousarray(a[k, turn]) for a in (position, velocity, effort)]
            if k == ragged:
                rows[2] = np.empty(0)
            write(k, JOINTS[turn], *rows)
            if base is not None and k % 2 == 0:
                when = _START + round(time[k] * 1e9)
                for topic, message in _of_base(store, stamp, header, when, base[k], one):
                    if topic not in others:
                        kind_of = message.__msgtype__
                        others[topic] = out.add_connection(topic, kind_of, typestore=store)
                    recorded = _START + round(2.0 * time[k] * 1e9)
                    out.write(others[topic], recorded, pack(message, message.__msgtype__))
            if gripper:
                write(k, ("finger",), *(np.zeros(1),) * 3)
    if kind in ("folder", "ros1") or packed:
        return file
    return next(folder.glob(f"*.{kind}"))


def _of_base(store: Any, stamp: Any, header: Any, when: int, row: np.ndarray, one: bool) -> Any:
    """Yield topics and messages of the base."""
    types, extra = store.types, {"seq": 0} if one else {}
    head = header(stamp=stamp(when // 10**9, when % 10**9), frame_id="", **extra)
    vector, turn = types["geometry_msgs/msg/Vector3"], types["geometry_msgs/msg/Quaternion"]
    point, nothing = types["geometry_msgs/msg/Point"], np.zeros(36)
    pose = types["geometry_msgs/msg/Pose"](point(*row[:3]), turn(*row[3:7]))
    twist = types["geometry_msgs/msg/Twist"](vector(*row[7:10]), vector(*row[10:13]))
    yield (
        "/odom",
        types["nav_msgs/msg/Odometry"](
            header=head,
            child_frame_id="base",
            pose=types["geometry_msgs/msg/PoseWithCovariance"](pose, nothing),
            twist=types["geometry_msgs/msg/TwistWithCovariance"](twist, nothing),
        ),
    )
    yield (
        "/imu",
        types["sensor_msgs/msg/Imu"](
            header=head,
            orientation=turn(*row[3:7]),
            orientation_covariance=nothing[:9],
            angular_velocity=vector(*row[10:13]),
            angular_velocity_covariance=nothing[:9],
            linear_acceleration=vector(0.0, 0.0, 9.81),
            linear_acceleration_covariance=nothing[:9],
        ),
    )
