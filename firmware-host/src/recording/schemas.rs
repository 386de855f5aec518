//! Definitions of the ROS 2 messages in a recording, as printed by `ros2 interface show` of ROS 2 Humble
//! and later, without comments. Each is the message followed by the messages that it contains.

macro_rules! part {
    ($name:literal, $definition:expr) => {
        concat!(
            "================================================================================\nMSG: ",
            $name,
            "\n",
            $definition
        )
    };
}

macro_rules! time {
    () => {
        part!("builtin_interfaces/Time", "int32 sec\nuint32 nanosec\n")
    };
}

macro_rules! header {
    () => {
        concat!(part!("std_msgs/Header", "builtin_interfaces/Time stamp\nstring frame_id\n"), time!())
    };
}

macro_rules! pose {
    () => {
        concat!(
            part!("geometry_msgs/Point", "float64 x\nfloat64 y\nfloat64 z\n"),
            part!("geometry_msgs/Quaternion", "float64 x 0\nfloat64 y 0\nfloat64 z 0\nfloat64 w 1\n")
        )
    };
}

/// A message type: its name and definition.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Schema {
    /// For example `std_msgs/msg/String`.
    pub name: &'static str,
    /// Text in the encoding `ros2msg`.
    pub definition: &'static str,
}

/// `std_msgs/msg/String`.
pub const STRING: Schema = Schema { name: "std_msgs/msg/String", definition: "string data\n" };

/// `sensor_msgs/msg/Image`.
pub const IMAGE: Schema = Schema {
    name: "sensor_msgs/msg/Image",
    definition: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nstring encoding\n",
        "uint8 is_bigendian\nuint32 step\n",
        "uint8[] data\n",
        header!()
    ),
};

/// `sensor_msgs/msg/CompressedImage`.
pub const COMPRESSED_IMAGE: Schema = Schema {
    name: "sensor_msgs/msg/CompressedImage",
    definition: concat!("std_msgs/Header header\nstring format\nuint8[] data\n", header!()),
};

/// `sensor_msgs/msg/PointCloud2`.
pub const POINT_CLOUD: Schema = Schema {
    name: "sensor_msgs/msg/PointCloud2",
    definition: concat!(
        "std_msgs/Header header\nuint32 height\nuint32 width\nPointField[] fields\nbool is_bigendian\n",
        "uint32 point_step\nuint32 row_step\nuint8[] data\nbool is_dense\n",
        part!(
            "sensor_msgs/PointField",
            concat!(
                "uint8 INT8=1\nuint8 UINT8=2\nuint8 INT16=3\nuint8 UINT16=4\nuint8 INT32=5\nuint8 UINT32=6\n",
                "uint8 FLOAT32=7\nuint8 FLOAT64=8\nstring name\nuint32 offset\nuint8 datatype\nuint32 count\n"
            )
        ),
        header!()
    ),
};

/// `geometry_msgs/msg/WrenchStamped`.
pub const WRENCH: Schema = Schema {
    name: "geometry_msgs/msg/WrenchStamped",
    definition: concat!(
        "std_msgs/Header header\nWrench wrench\n",
        header!(),
        part!("geometry_msgs/Wrench", "Vector3 force\nVector3 torque\n"),
        part!("geometry_msgs/Vector3", "float64 x\nfloat64 y\nfloat64 z\n")
    ),
};

/// `sensor_msgs/msg/JointState`.
pub const JOINT_STATE: Schema = Schema {
    name: "sensor_msgs/msg/JointState",
    definition: concat!(
        "std_msgs/Header header\nstring[] name\nfloat64[] position\nfloat64[] velocity\nfloat64[] effort\n",
        header!()
    ),
};

/// `geometry_msgs/msg/PoseStamped`.
pub const POSE: Schema = Schema {
    name: "geometry_msgs/msg/PoseStamped",
    definition: concat!(
        "std_msgs/Header header\nPose pose\n",
        part!("geometry_msgs/Pose", "Point position\nQuaternion orientation\n"),
        pose!(),
        header!()
    ),
};

/// `geometry_msgs/msg/PoseWithCovarianceStamped`.
pub const POSE_WITH_COVARIANCE: Schema = Schema {
    name: "geometry_msgs/msg/PoseWithCovarianceStamped",
    definition: concat!(
        "std_msgs/Header header\nPoseWithCovariance pose\n",
        part!("geometry_msgs/PoseWithCovariance", "Pose pose\nfloat64[36] covariance\n"),
        part!("geometry_msgs/Pose", "Point position\nQuaternion orientation\n"),
        pose!(),
        header!()
    ),
};
