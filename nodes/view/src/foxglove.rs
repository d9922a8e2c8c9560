//! Foxglove's WebSocket protocol, live mode: Foxglove and Lichtblick connect to the page's port and read the topics of the
//! graph.
//!
//! What goes where: the [`message`]s of the protocol; the [`offer`], which topics and how often, as the parameters say; the
//! [`channel`]s, what of it is there; a [`feed`], the messages of a channel that somebody has subscribed to; an [`outbox`],
//! what waits for one client; the [`hub`], which joins them; a [`client`], its socket.
//!
//! A topic is subscribed to in DDS only while a client subscribes to it, once for all clients, with best effort: no publisher
//! waits for a viewer. Nothing is offered but to look: no publishing, parameters or services of clients.
//!
//! The protocol is <https://github.com/foxglove/ws-protocol/blob/main/docs/spec.md>. Its successor, `foxglove.sdk.v1`, has
//! the same messages and adds some that are not needed here. The crate `foxglove` (0.30) does not serve it on a socket that is
//! there: its server has a listener and handshake of its own, and the types of its messages are private.

mod channel;
pub mod client;
mod feed;
pub mod hub;
mod message;
pub mod offer;
mod outbox;

/// The subprotocols, the newer one first. Foxglove asks for both, Lichtblick for the older one.
pub const PROTOCOLS: [&str; 2] = ["foxglove.sdk.v1", "foxglove.websocket.v1"];
