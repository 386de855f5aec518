//! The WebSocket that Foxglove and Lichtblick open.

use super::{Message, Opened, Protocol, PublishError};
use crate::config::FoxgloveConfig;
use crate::recording::Topic;
use foxglove::{ChannelBuilder, Context, PartialMetadata, RawChannel, Schema, WebSocketServer};
use std::sync::Arc;

/// Messages that wait for one viewer; beyond them its oldest are dropped.
const BACKLOG: usize = 256;

pub(super) fn open(settings: &FoxgloveConfig) -> Result<Opened, PublishError> {
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
    let mut channels: Vec<Arc<RawChannel>> = Vec::new();
    for topic in Topic::ALL {
        let schema = topic.schema();
        let schema = Schema::new(schema.name, "ros2msg", schema.definition.as_bytes());
        let channel =
            ChannelBuilder::new(topic.name()).context(&context).schema(schema).message_encoding("cdr");
        channels.push(channel.build_raw().map_err(fail)?);
    }
    let address = format!("ws://{}:{}", settings.host, server.port());
    let send = move |Message { topic, time_ns, data }: Message| {
        // The server lives as long as this closure does.
        let _ = &server;
        if let Some(channel) = channels.get(topic as usize) {
            channel.log_with_meta(&data, PartialMetadata::with_log_time(time_ns));
        }
        Ok(())
    };
    Ok(Opened { address, send: Box::new(send) })
}
