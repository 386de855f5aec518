//! A ROS 2 node that reads what `gelstereo-host sense --publish zenoh` publishes, written with `hiroz`, whose
//! codecs, key expressions, type hashes and graph are its own.
//!
//! usage: ros-peer ENDPOINT DOMAIN. Prints the topics of the graph and one message of each kind, one line
//! each.

use hiroz::Builder;
use hiroz::context::ZContextBuilder;
use hiroz::dynamic::{DynamicMessage, FieldType, MessageSchema};
use std::sync::Arc;
use std::time::{Duration, Instant};

type Failure = Box<dyn std::error::Error + Send + Sync>;
type Fields<'a> = &'a [(&'a str, FieldType)];

const LIMIT: Duration = Duration::from_secs(60);

fn schema(name: &str, fields: Fields<'_>) -> Result<Arc<MessageSchema>, Failure> {
    let builder = fields
        .iter()
        .fold(MessageSchema::builder(name), |builder, (field, kind)| builder.field(field, kind.clone()));
    Ok(builder.build()?)
}

/// From the definitions of ROS 2's own interface packages.
struct Schemas {
    string: Arc<MessageSchema>,
    cloud: Arc<MessageSchema>,
    pose: Arc<MessageSchema>,
}

impl Schemas {
    fn new() -> Result<Self, Failure> {
        use FieldType::{Array, Bool, Float64, Int32, Message, Sequence, String, Uint8, Uint32};
        let bytes = || Sequence(Box::new(Uint8));
        let time = schema("builtin_interfaces/msg/Time", &[("sec", Int32), ("nanosec", Uint32)])?;
        let header = schema("std_msgs/msg/Header", &[("stamp", Message(time)), ("frame_id", String)])?;
        let field = schema(
            "sensor_msgs/msg/PointField",
            &[("name", String), ("offset", Uint32), ("datatype", Uint8), ("count", Uint32)],
        )?;
        let cloud = schema(
            "sensor_msgs/msg/PointCloud2",
            &[
                ("header", Message(header.clone())),
                ("height", Uint32),
                ("width", Uint32),
                ("fields", Sequence(Box::new(Message(field)))),
                ("is_bigendian", Bool),
                ("point_step", Uint32),
                ("row_step", Uint32),
                ("data", bytes()),
                ("is_dense", Bool),
            ],
        )?;
        let axes = |names: &[&str]| names.iter().map(|&name| (name.to_owned(), Float64)).collect::<Vec<_>>();
        let numbers = |name: &str, axes: Vec<(std::string::String, FieldType)>| {
            let fields: Vec<(&str, FieldType)> =
                axes.iter().map(|(axis, kind)| (axis.as_str(), kind.clone())).collect();
            schema(name, &fields)
        };
        let point = numbers("geometry_msgs/msg/Point", axes(&["x", "y", "z"]))?;
        let turn = numbers("geometry_msgs/msg/Quaternion", axes(&["x", "y", "z", "w"]))?;
        let pose = schema(
            "geometry_msgs/msg/Pose",
            &[("position", Message(point)), ("orientation", Message(turn))],
        )?;
        let spread = schema(
            "geometry_msgs/msg/PoseWithCovariance",
            &[("pose", Message(pose)), ("covariance", Array(Box::new(Float64), 36))],
        )?;
        Ok(Self {
            string: schema("std_msgs/msg/String", &[("data", String)])?,
            cloud,
            pose: schema(
                "geometry_msgs/msg/PoseWithCovarianceStamped",
                &[("header", Message(header)), ("pose", Message(spread))],
            )?,
        })
    }
}

fn main() -> Result<(), Failure> {
    let mut arguments = std::env::args().skip(1);
    let (Some(endpoint), Some(domain)) = (arguments.next(), arguments.next()) else {
        return Err("usage: ros-peer ENDPOINT DOMAIN".into());
    };
    let context = ZContextBuilder::default()
        .with_domain_id(domain.parse()?)
        .disable_multicast_scouting()
        .with_mode("client")
        .with_connect_endpoints([endpoint])
        .build()?;
    let node = context.create_node("reader").build()?;
    let schemas = Schemas::new()?;
    let contact = node.create_dyn_sub("/gelstereo/contact", schemas.string).build()?;
    let points = node.create_dyn_sub("/gelstereo/points", schemas.cloud).build()?;
    let pose = node.create_dyn_sub("/gelstereo/pose", schemas.pose).build()?;

    let begun = Instant::now();
    let mut topics = Vec::new();
    while topics.len() < 6 && begun.elapsed() < LIMIT {
        std::thread::sleep(Duration::from_millis(100));
        topics = node.graph().get_topic_names_and_types();
        topics.retain(|(topic, _)| {
            topic.starts_with("/gelstereo/") || topic.starts_with("/robot/") || topic.starts_with("/gripper/")
        });
    }
    for (topic, kind) in topics {
        println!("topic {topic} {kind}");
    }
    for (name, _) in node.graph().get_node_names() {
        println!("node {name}");
    }
    println!("contact {}", contact.recv_timeout(LIMIT)?.get::<String>("data")?);
    let cloud = points.recv_timeout(LIMIT)?;
    let size = |field: &str| cloud.get::<u32>(field);
    let frame: String = cloud.get("header.frame_id")?;
    println!("points {} {} {} {frame}", size("height")?, size("width")?, size("point_step")?);
    let place: DynamicMessage = pose.recv_timeout(LIMIT)?;
    let axis = |name: &str| place.get::<f64>(&format!("pose.pose.{name}"));
    println!("pose {} {} {}", axis("position.x")?, axis("position.y")?, axis("position.z")?);
    println!("turn {}", axis("orientation.w")?);
    Ok(())
}
