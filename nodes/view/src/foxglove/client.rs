//! The socket of a client.

use super::{
    hub::{Guest, Hub},
    message::{self, ClientMessage, Level, ServerMessage},
};
use crate::socket::{PING_PERIOD, deliver};
use axum::extract::ws::{Message, WebSocket};
use futures::{
    StreamExt as _,
    stream::{SplitSink, SplitStream},
};
use std::sync::Arc;
use tokio::{sync::mpsc, time::MissedTickBehavior};

/// Longest message of a client \[byte\]: some thousand subscriptions.
pub(crate) const MAX_REQUEST: usize = 64 << 10;
/// The most waiting replies; a client that does not read misses further ones.
const ANSWERS: usize = 16;

/// Sent if the view shows a bag.
const OF_BAG: &str =
    "wm view shows a bag, which has no live topics: open the bag's .mcap file instead";
/// Sent for other requests.
const NOT_OFFERED: &str = "not offered: clients can subscribe to topics, and neither publish nor call services or set parameters";

/// Serves a client until it leaves, stalls, or sends an invalid message.
pub(crate) async fn serve(socket: WebSocket, hub: &Arc<Hub>, is_bag: bool) {
    let (sink, stream) = socket.split();
    let (sender, answers) = mpsc::channel(ANSWERS);
    let guest = hub.guest();
    let first = if is_bag { Some(OF_BAG) } else { None };
    let first = first.map(|message| told(Level::Info, message));
    let first: Vec<String> = std::iter::once(hub.server_info()).chain(first).collect();
    let ended = tokio::select! {
        ended = send(sink, &guest, first, answers) => ended,
        ended = receive(stream, &guest, sender) => ended,
    };
    if let Err(reason) = ended {
        tracing::debug!("a Foxglove client is disconnected: {reason}");
    }
}

fn told(level: Level, message: &str) -> String {
    ServerMessage::Status { level, message }.text()
}

async fn send(
    mut sink: SplitSink<WebSocket, Message>,
    guest: &Guest,
    first: Vec<String>,
    mut answers: mpsc::Receiver<String>,
) -> Result<(), String> {
    let mut news = guest.news();
    let mut pings = tokio::time::interval(PING_PERIOD);
    pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
    for text in first.into_iter().chain(news.take()) {
        deliver(&mut sink, Message::Text(text.into())).await?;
    }
    loop {
        tokio::select! {
            // topics last: they may always have messages
            biased;
            _ = pings.tick() => {
                deliver(&mut sink, Message::Ping(Vec::new().into())).await?;
                if let Some(losses) = guest.losses() {
                    let text = told(Level::Warning, &losses);
                    deliver(&mut sink, Message::Text(text.into())).await?;
                }
            }
            Some(answer) = answers.recv() => deliver(&mut sink, Message::Text(answer.into())).await?,
            () = news.changed() => {
                for text in news.take() {
                    deliver(&mut sink, Message::Text(text.into())).await?;
                }
            }
            (subscription, sample) = guest.next() => {
                let data = message::data(subscription, sample.log_time_ns, &sample.cdr);
                deliver(&mut sink, Message::Binary(data)).await?;
            }
        }
    }
}

async fn receive(
    mut stream: SplitStream<WebSocket>,
    guest: &Guest,
    answers: mpsc::Sender<String>,
) -> Result<(), String> {
    let answer = |level, text: &str| drop(answers.try_send(told(level, text)));
    while let Some(message) = stream.next().await {
        match message.map_err(|error| error.to_string())? {
            Message::Text(text) => match ClientMessage::parse(&text)? {
                ClientMessage::Subscribe { subscriptions } => {
                    for subscription in subscriptions {
                        if let Err(error) = guest.subscribe(subscription) {
                            answer(Level::Error, &error.to_string());
                        }
                    }
                }
                ClientMessage::Unsubscribe { subscription_ids } => {
                    for id in subscription_ids {
                        guest.unsubscribe(id);
                    }
                }
                ClientMessage::Other => answer(Level::Warning, NOT_OFFERED),
            },
            // a publication or a service call
            Message::Binary(_) => answer(Level::Warning, NOT_OFFERED),
            Message::Close(_) => break,
            Message::Ping(_) | Message::Pong(_) => {}
        }
    }
    Ok(())
}
