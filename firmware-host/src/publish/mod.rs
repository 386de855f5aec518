//! Publishes live results to other programs: the messages of a recording, over zenoh or to Foxglove.
//!
//! A publisher never blocks sensing: messages that listeners do not take in time are dropped, oldest
//! first, and counted.

#[cfg(feature = "foxglove")]
mod foxglove;
mod outlet;
mod ros_names;
mod type_hash;
#[cfg(feature = "zenoh")]
mod zenoh;

pub use outlet::{Outlet, Overflow};
pub use ros_names::{Node, TopicNames, attachment, topic_names};
pub use type_hash::rihs01;

use crate::config::{Config, SenseConfig};
use crate::recording::{MessageSink, Topic};
use gelstereo_core::params::{ForceMethod, Params, SlipMethod};
use std::time::Duration;

/// Topics of sensing without a robot; force, slip and images are added on request.
const RESULTS: [Topic; 6] =
    [Topic::Points, Topic::Frame, Topic::Pose, Topic::Stage, Topic::Capture, Topic::Contact];
const IMAGES: [Topic; 2] = [Topic::LeftImage, Topic::RightImage];

/// Longest time for sending the remaining messages at the end.
const LAST_SENDS: Duration = Duration::from_secs(1);

/// Transport to the listeners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// ROS 2 messages over zenoh.
    Zenoh,
    /// The WebSocket of Foxglove and Lichtblick.
    Foxglove,
}

impl Protocol {
    /// Name of the protocol.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Zenoh => "zenoh",
            Self::Foxglove => "foxglove",
        }
    }
}

/// Reason why publishing is impossible.
#[derive(Debug)]
pub enum PublishError {
    /// This program was built without the protocol.
    NotBuilt {
        /// The protocol.
        protocol: Protocol,
    },
    /// The protocol cannot be opened.
    Open {
        /// The protocol.
        protocol: Protocol,
        /// Reason.
        reason: String,
    },
}

impl std::fmt::Display for PublishError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::NotBuilt { protocol } => {
                let name = protocol.name();
                write!(f, "this gelstereo-host was built without {name}; build it with `--features {name}`")
            }
            Self::Open { protocol, reason } => write!(f, "cannot publish by {}: {reason}", protocol.name()),
        }
    }
}

impl std::error::Error for PublishError {}

/// A message to publish.
#[derive(Clone, Debug)]
pub struct Message {
    /// Topic.
    pub topic: Topic,
    /// Time of the frame source.
    pub time_ns: u64,
    /// Data in CDR encoding.
    pub data: Vec<u8>,
}

/// An open transport.
struct Opened {
    /// Address for listeners.
    address: String,
    /// Sends one message; fails only if no further message can be sent.
    send: Box<dyn FnMut(Message) -> Result<(), String> + Send>,
}

/// An output that sends messages on its own thread.
#[derive(Debug)]
pub struct Publisher {
    protocol: Protocol,
    address: String,
    topics: Vec<Topic>,
    outlet: Outlet<Message>,
}

impl Publisher {
    /// Opens the protocol with its settings.
    ///
    /// # Errors
    /// [`PublishError`].
    pub fn open(protocol: Protocol, config: &Config) -> Result<Self, PublishError> {
        let settings = &config.sense;
        let topics = topics(protocol, settings, &config.params);
        let Opened { address, send } = open(protocol, settings, &topics)?;
        let outlet = Outlet::spawn(protocol.name(), send)
            .map_err(|error| PublishError::Open { protocol, reason: error.to_string() })?;
        Ok(Self { protocol, address, topics, outlet })
    }

    /// Protocol.
    #[must_use]
    pub const fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// Address for listeners.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Number of messages dropped because listeners were too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.outlet.dropped()
    }

    /// Sends waiting messages for at most a second and closes the output. Returns the number of unsent
    /// messages.
    pub fn finish(self) -> usize {
        self.outlet.finish(LAST_SENDS)
    }
}

impl MessageSink for Publisher {
    fn write(&mut self, topic: Topic, time_ns: u64, message: &[u8]) {
        if !self.topics.contains(&topic) {
            return;
        }
        let message = Message { topic, time_ns, data: message.to_vec() };
        let bytes = message.data.len();
        self.outlet.push(message, bytes, Overflow::DropOldest);
    }

    fn fault(&self) -> Option<String> {
        self.outlet.fault()
    }
}

/// Topics with these settings. Those that would stay silent are not listed.
fn topics(protocol: Protocol, settings: &SenseConfig, params: &Params) -> Vec<Topic> {
    let images = match protocol {
        Protocol::Zenoh => settings.zenoh.images,
        Protocol::Foxglove => settings.foxglove.images,
    };
    let felt = [
        (Topic::Wrench, params.force.method != ForceMethod::None),
        (Topic::Slip, params.slip.method != SlipMethod::None),
    ];
    let felt = felt.into_iter().filter_map(|(topic, is_on)| is_on.then_some(topic));
    RESULTS.into_iter().chain(felt).chain(IMAGES.into_iter().filter(|_| images)).collect()
}

fn open(protocol: Protocol, settings: &SenseConfig, topics: &[Topic]) -> Result<Opened, PublishError> {
    match protocol {
        #[cfg(feature = "zenoh")]
        Protocol::Zenoh => zenoh::open(&settings.zenoh, topics),
        #[cfg(feature = "foxglove")]
        Protocol::Foxglove => foxglove::open(&settings.foxglove, topics),
        #[cfg(not(all(feature = "zenoh", feature = "foxglove")))]
        _ => {
            let _ = (settings, topics);
            Err(PublishError::NotBuilt { protocol })
        }
    }
}
