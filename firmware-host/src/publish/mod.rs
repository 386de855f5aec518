//! Results live to other programs: the same messages as in a recording, over zenoh or to Foxglove.
//!
//! A publisher never holds up sensing: what its listeners do not take in time is dropped, oldest first, and
//! counted.

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

use crate::config::SenseConfig;
use crate::recording::{MessageSink, Topic};
use std::time::Duration;

/// What sensing alone has to say; images besides where they are wanted.
const RESULTS: [Topic; 6] =
    [Topic::Points, Topic::Frame, Topic::Pose, Topic::Stage, Topic::Capture, Topic::Contact];
const IMAGES: [Topic; 2] = [Topic::LeftImage, Topic::RightImage];

/// How long a publisher may still send at the end.
const LAST_SENDS: Duration = Duration::from_secs(1);

/// A way to the listeners.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Protocol {
    /// ROS 2 messages over zenoh.
    Zenoh,
    /// The WebSocket of Foxglove and Lichtblick.
    Foxglove,
}

impl Protocol {
    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Zenoh => "zenoh",
            Self::Foxglove => "foxglove",
        }
    }
}

/// Why nothing can be published.
#[derive(Debug)]
pub enum PublishError {
    /// This program was built without it.
    NotBuilt {
        /// Which.
        protocol: Protocol,
    },
    /// It cannot be opened.
    Open {
        /// Which.
        protocol: Protocol,
        /// Why.
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

/// One message on its way.
#[derive(Clone, Debug)]
pub struct Message {
    /// Its topic.
    pub topic: Topic,
    /// The frame source's time.
    pub time_ns: u64,
    /// CDR.
    pub data: Vec<u8>,
}

/// An open way to the listeners.
struct Opened {
    /// Where listeners find it.
    address: String,
    /// Sends one message; it fails only if none can be sent any more.
    send: Box<dyn FnMut(Message) -> Result<(), String> + Send>,
}

/// An output for messages that sends them on a thread of its own.
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
    pub fn open(protocol: Protocol, settings: &SenseConfig) -> Result<Self, PublishError> {
        let images = match protocol {
            Protocol::Zenoh => settings.zenoh.images,
            Protocol::Foxglove => settings.foxglove.images,
        };
        let topics: Vec<Topic> = RESULTS.into_iter().chain(IMAGES.into_iter().filter(|_| images)).collect();
        let Opened { address, send } = open(protocol, settings, &topics)?;
        let outlet = Outlet::spawn(protocol.name(), send)
            .map_err(|error| PublishError::Open { protocol, reason: error.to_string() })?;
        Ok(Self { protocol, address, topics, outlet })
    }

    /// Its protocol.
    #[must_use]
    pub const fn protocol(&self) -> Protocol {
        self.protocol
    }

    /// Where listeners find it.
    #[must_use]
    pub fn address(&self) -> &str {
        &self.address
    }

    /// Messages that were dropped since listeners were too slow.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.outlet.dropped()
    }

    /// Sends what waits, for a second at most, and closes it. Returns how many messages were not sent.
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
