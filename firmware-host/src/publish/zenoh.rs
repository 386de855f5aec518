//! ROS 2 messages over zenoh.

use super::ros_names::{Node, TopicNames, attachment, topic_names};
use super::{Message, Opened, Protocol, PublishError};
use crate::config::ZenohConfig;
use crate::recording::Topic;
use std::time::{SystemTime, UNIX_EPOCH};
use zenoh::Wait;
use zenoh::liveliness::LivelinessToken;
use zenoh::pubsub::Publisher;
use zenoh::qos::CongestionControl;

/// Name of the ROS 2 node.
const NODE: &str = "gelstereo";

/// State of the session while it publishes.
struct Publishers {
    publishers: Vec<Channel>,
    /// Dropping them removes node and topics from the graph.
    _tokens: Vec<LivelinessToken>,
    _session: zenoh::Session,
}

/// Publisher of one topic.
struct Channel {
    topic: Topic,
    publisher: Publisher<'static>,
    sequence: i64,
    /// Identity of the publisher.
    gid: [u8; 16],
}

pub(super) fn open(settings: &ZenohConfig, topics: &[Topic]) -> Result<Opened, PublishError> {
    let fail = |error: zenoh::Error| PublishError::Open {
        protocol: Protocol::Zenoh,
        reason: format!("{error}; see sense.zenoh.connect and sense.zenoh.listen"),
    };
    let session = zenoh::open(config(settings).map_err(fail)?).wait().map_err(fail)?;
    let node = Node { domain_id: settings.domain_id, session_id: session.zid().to_string(), name: NODE };
    let mut tokens = vec![session.liveliness().declare_token(node.token()).wait().map_err(fail)?];
    let mut publishers = Vec::new();
    for (id, &topic) in (1..).zip(topics) {
        let TopicNames { key, token } = topic_names(&node, topic, id, settings.type_hash);
        // A slow listener loses messages instead of blocking the others.
        let publisher = session.declare_publisher(key).congestion_control(CongestionControl::Drop);
        let publisher = publisher.wait().map_err(fail)?;
        let gid = gid(&token);
        tokens.push(session.liveliness().declare_token(token).wait().map_err(fail)?);
        publishers.push(Channel { topic, publisher, sequence: 0, gid });
    }
    let address = format!("domain {}, listening on {}", settings.domain_id, settings.listen.join(", "));
    let mut held = Publishers { publishers, _tokens: tokens, _session: session };
    Ok(Opened { address, send: Box::new(move |message| held.send(message)) })
}

impl Publishers {
    fn send(&mut self, Message { topic, data, .. }: Message) -> Result<(), String> {
        let channel = self.publishers.iter_mut().find(|channel| channel.topic == topic);
        let Some(channel) = channel else { return Ok(()) };
        channel.sequence += 1;
        // ROS 2 expects the wall clock here; the frame source's time is in the message.
        let now = SystemTime::now().duration_since(UNIX_EPOCH).unwrap_or_default().as_nanos() as i64;
        let attachment = attachment(channel.sequence, now, &channel.gid);
        channel.publisher.put(data).attachment(attachment).wait().map_err(|error| error.to_string())
    }
}

fn config(settings: &ZenohConfig) -> Result<zenoh::Config, zenoh::Error> {
    let list = |endpoints: &[String]| serde_json::Value::from(endpoints).to_string();
    let mut config = zenoh::Config::default();
    for (key, value) in [
        ("mode", "\"peer\"".to_owned()),
        ("connect/endpoints", list(&settings.connect)),
        // A missing router is retried in the background.
        ("connect/timeout_ms", "0".to_owned()),
        ("connect/exit_on_failure", "false".to_owned()),
        ("listen/endpoints", list(&settings.listen)),
        ("scouting/multicast/enabled", settings.multicast.to_string()),
    ] {
        config.insert_json5(key, &value)?;
    }
    Ok(config)
}

/// Sixteen bytes that are unique to publisher and session: a hash of the token, which names both.
fn gid(token: &str) -> [u8; 16] {
    let half = |salt: u8| {
        let digest = gelstereo_core::digest::Digest::new().bytes(&[salt]).bytes(token.as_bytes());
        digest.value().to_le_bytes()
    };
    let (low, high) = (half(0), half(1));
    core::array::from_fn(|i| if i < 8 { low[i] } else { high[i - 8] })
}
