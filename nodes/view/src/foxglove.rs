//! Foxglove's WebSocket protocol, live mode: Foxglove and Lichtblick connect to the page's port and read the topics of
//! the graph.
//!
//! The modules: [`message`]s of the protocol; the [`offer`] of topics and rates, from parameters; [`channel`]s, the
//! offered topics that exist; a [`feed`], the messages of a subscribed channel; an [`outbox`], the waiting messages of
//! a client; the [`hub`], which connects them; a [`client`], its socket.
//!
//! The view subscribes to a topic in DDS only while a client does, once for all clients, with best effort: no publisher
//! waits for a viewer. Clients cannot publish, set parameters or call services.
//!
//! The protocol is <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>. Its successor, `foxglove.sdk.v1`,
//! has the same messages and others that are not needed here. The crate `foxglove` (0.30) cannot serve it on an
//! existing socket: its server has its own listener and handshake, and the types of its messages are private.

mod channel;
pub(crate) mod client;
mod feed;
pub(crate) mod hub;
mod message;
pub(crate) mod offer;
mod outbox;

/// The subprotocols, the newer one first. Foxglove requests both, Lichtblick the older one.
pub(crate) const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
