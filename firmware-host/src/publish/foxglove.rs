//! WebSocket server for Foxglove and Lichtblick.

use super::{Message, Opened, Protocol, PublishError};
use crate::config::FoxgloveConfig;
use crate::recording::Topic;
use foxglove::{
    ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer, WebSocketServerHandle,
};
use std::sync::Arc;

/// Largest number of waiting messages per viewer; beyond it the oldest are dropped.
const BACKLOG: usize = 256;

pub(super) fn open(settings: &FoxgloveConfig, topics: &[Topic]) -> Result<Opened, PublishError> {
    let fail = |error: foxglove::FoxgloveError| PublishError::Open {
        protocol: Protocol::Foxglove,
        reason: format!("{error}; see sense.foxglove.host and sense.foxglove.port"),
    };
    let context = Context::new();
    let server = WebSocketServer::new()
        .context(&context)
        .name("gelstereo-host")
        .message_backlog_size(BACKLOG)
        .bind(settings.host.clone(), settings.port)
        .start_blocking()
        .map_err(fail)?;
    let mut channels = Vec::new();
    for &topic in topics {
        let schema = topic.schema();
        let schema = Schema::new(schema.name, "ros2msg", schema.definition.as_bytes());
        let channel =
            ChannelBuilder::new(topic.name()).context(&context).schema(schema).message_encoding("cdr");
        channels.push((topic, channel.build_raw().map_err(fail)?));
    }
    let address = format!("ws://{}:{}", settings.host, server.port());
    let viewers = Viewers { channels, _server: server, _context: context };
    Ok(Opened { address, send: Box::new(move |message| viewers.send(&message)) })
}

/// Server for the viewers; it lives as long as messages are sent.
struct Viewers {
    channels: Vec<(Topic, Arc<RawChannel>)>,
    _server: WebSocketServerHandle,
    /// Server and channels are linked by the context but do not keep it alive.
    _context: Arc<Context>,
}

impl Viewers {
    fn send(&self, Message { topic, time_ns, data }: &Message) -> Result<(), String> {
        if let Some((_, channel)) = self.channels.iter().find(|(of, _)| of == topic) {
            channel.log_with_meta(data, PartialMetadata::with_log_time(*time_ns));
        }
        Ok(())
    }
}
