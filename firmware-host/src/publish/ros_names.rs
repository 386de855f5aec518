//! Names of nodes and topics in the format of `rmw_zenoh` (its design document, "Graph Cache" and
//! "Publishers").
//!
//! A message is published under the key `<domain>/<topic>/<type>/<hash>`. One liveliness token announces
//! the publisher to `ros2 topic list`, another one the node.

use super::type_hash::rihs01;
use crate::config::TypeHash;
use crate::recording::Topic;

/// Encoding of an empty name.
const EMPTY: &str = "%";
/// Encoding of a `/` within a name.
const SLASH: &str = "%";
/// Reliable, volatile, the last 10 messages; the other fields are empty for their defaults.
const QOS: &str = "::,10:,:,:,,";

/// The publishing node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Node {
    /// `ROS_DOMAIN_ID`.
    pub domain_id: u32,
    /// Identifier of the zenoh session, in hexadecimal.
    pub session_id: String,
    /// Name of the node.
    pub name: &'static str,
}

impl Node {
    /// Number of the node within its session.
    const ID: u32 = 0;

    /// Liveliness token of the node.
    #[must_use]
    pub fn token(&self) -> String {
        let Self { domain_id, session_id, name } = self;
        let id = Self::ID;
        format!("@ros2_lv/{domain_id}/{session_id}/{id}/{id}/NN/{EMPTY}/{EMPTY}/{name}")
    }
}

/// Keys of one topic's publisher.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct TopicNames {
    /// Key of the messages.
    pub key: String,
    /// Liveliness token of the publisher.
    pub token: String,
}

/// Keys of a topic's publisher, which is entity `id` of its session.
#[must_use]
pub fn topic_names(node: &Node, topic: Topic, id: u32, hash: TypeHash) -> TopicNames {
    let Node { domain_id, session_id, name } = node;
    let schema = topic.schema();
    let hash = match hash {
        TypeHash::Rihs01 => rihs01(schema.name),
        TypeHash::NotSupported => None,
    };
    let hash = hash.unwrap_or("TypeHashNotSupported");
    let type_name = dds_type_name(schema.name);
    let mangled = topic.name().replace('/', SLASH);
    let path = topic.name().trim_start_matches('/');
    let node = format!("{session_id}/{}/{id}/MP/{EMPTY}/{EMPTY}/{name}", Node::ID);
    TopicNames {
        key: format!("{domain_id}/{path}/{type_name}/{hash}"),
        token: format!("@ros2_lv/{domain_id}/{node}/{mangled}/{type_name}/{hash}/{QOS}"),
    }
}

/// DDS type name: `std_msgs/msg/String` becomes `std_msgs::msg::dds_::String_`.
fn dds_type_name(name: &str) -> String {
    match name.rsplit_once('/') {
        Some((package, message)) => format!("{}::dds_::{message}_", package.replace('/', "::")),
        None => name.to_owned(),
    }
}

/// Attachment of every message: its number, its time and the sender, in the encoding of zenoh's serializer.
#[must_use]
pub fn attachment(sequence: i64, time_ns: i64, gid: &[u8; 16]) -> Vec<u8> {
    let mut bytes = Vec::with_capacity(33);
    bytes.extend_from_slice(&sequence.to_le_bytes());
    bytes.extend_from_slice(&time_ns.to_le_bytes());
    // Length of the following list; one byte below 128.
    bytes.push(gid.len() as u8);
    bytes.extend_from_slice(gid);
    bytes
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Example of rmw_zenoh's design document, with this host's topic.
    #[test]
    fn names_are_those_of_rmw_zenoh() {
        let node = Node {
            domain_id: 2,
            session_id: "aac3178e146ba6f1fc6e6a4085e77f21".to_owned(),
            name: "gelstereo",
        };
        assert_eq!(node.token(), "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/0/NN/%/%/gelstereo");
        let names = topic_names(&node, Topic::Stage, 10, TypeHash::Rihs01);
        let hash = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18";
        assert_eq!(names.key, format!("2/gelstereo/stage/std_msgs::msg::dds_::String_/{hash}"));
        assert_eq!(
            names.token,
            format!(
                "@ros2_lv/2/aac3178e146ba6f1fc6e6a4085e77f21/0/10/MP/%/%/gelstereo/%gelstereo%stage/\
                 std_msgs::msg::dds_::String_/{hash}/::,10:,:,:,,"
            )
        );
        let old = topic_names(&node, Topic::Stage, 10, TypeHash::NotSupported);
        assert!(old.key.ends_with("/TypeHashNotSupported"));
    }

    #[test]
    fn an_attachment_is_33_bytes() {
        let bytes = attachment(1, 2, &[3; 16]);
        assert_eq!(bytes.len(), 33);
        assert_eq!((bytes[0], bytes[8], bytes[16], bytes[17]), (1, 2, 16, 3));
    }
}
