//! The socket of a client.

use crate::{
    command::Numbered,
    cursor::Cursor,
    shared::{ClientCommand, Shared},
};
use axum::{
    Error,
    extract::ws::{Message, WebSocket},
};
use futures::{
    SinkExt as _, StreamExt as _,
    stream::{SplitSink, SplitStream},
};
use std::time::Duration;
use tokio::{sync::mpsc, time::MissedTickBehavior};

/// How long sending a message may take. A slower client has stalled: it is disconnected, and its page reconnects when
/// it wakes.
const SEND_LIMIT: Duration = Duration::from_secs(10);
/// How often clients are pinged.
pub(crate) const PING_PERIOD: Duration = Duration::from_secs(10);
/// The most waiting replies to commands.
const ANSWERS: usize = 16;
/// The shortest time between deliveries: 60 pictures a second, even with a camera of 200 Hz.
const PACE: Duration = Duration::from_millis(16);

/// The most invalid messages of a client; then it is disconnected.
const MALFORMED: usize = 20;

/// Serves a client until it leaves, stalls, or has sent too many invalid messages.
pub(crate) async fn serve(socket: WebSocket, shared: &Shared) {
    // so that it does not wait for the next one
    shared.renew_status();
    let (sink, stream) = socket.split();
    let (sender, answers) = mpsc::channel(ANSWERS);
    let ended = tokio::select! {
        ended = send(sink, shared, answers) => ended,
        ended = receive(stream, shared, sender) => ended,
    };
    if let Err(reason) = ended {
        tracing::debug!("a client is disconnected: {reason}");
    }
}

/// Sends a message.
///
/// # Errors
/// The client has gone or stalled; the reason as text.
pub(crate) async fn deliver(
    sink: &mut SplitSink<WebSocket, Message>,
    message: Message,
) -> Result<(), String> {
    let sent = tokio::time::timeout(SEND_LIMIT, sink.send(message)).await;
    sent.map_err(|_| "it has stalled".to_owned())?
        .map_err(|error: Error| error.to_string())
}

async fn send(
    mut sink: SplitSink<WebSocket, Message>,
    shared: &Shared,
    mut answers: mpsc::Receiver<String>,
) -> Result<(), String> {
    let mut news = shared.news();
    let mut pings = tokio::time::interval(PING_PERIOD);
    pings.set_missed_tick_behavior(MissedTickBehavior::Delay);
    let mut cursor = Cursor::default();
    let hello = shared.settings().hello.clone();
    deliver(&mut sink, Message::Text(hello.into())).await?;
    loop {
        news.mark_unchanged();
        loop {
            if let Ok(answer) = answers.try_recv() {
                deliver(&mut sink, Message::Text(answer.into())).await?;
            }
            let next = {
                let known = shared.known();
                cursor.next(&known.state, &known.status)
            };
            let Some(message) = next else { break };
            deliver(&mut sink, message).await?;
        }
        tokio::time::sleep(PACE).await;
        tokio::select! {
            changed = news.changed() => changed.map_err(|_| "the node ends".to_owned())?,
            Some(answer) = answers.recv() => deliver(&mut sink, Message::Text(answer.into())).await?,
            _ = pings.tick() => deliver(&mut sink, Message::Ping(Vec::new().into())).await?,
        }
    }
}

async fn receive(
    mut stream: SplitStream<WebSocket>,
    shared: &Shared,
    answers: mpsc::Sender<String>,
) -> Result<(), String> {
    let mut malformed = 0;
    let mut refuse = |number, reason: &str| {
        malformed += 1;
        if malformed > MALFORMED {
            return Err(format!("{malformed} messages were invalid; {reason}"));
        }
        // a client that does not read misses some replies
        answers.try_send(answer(number, Err(reason))).ok();
        Ok(())
    };
    while let Some(message) = stream.next().await {
        match message.map_err(|error| error.to_string())? {
            Message::Text(text) => {
                let Numbered { number, command } = match Numbered::parse(&text) {
                    Ok(numbered) => numbered,
                    Err((number, malformed)) => {
                        refuse(number, &malformed.to_string())?;
                        continue;
                    }
                };
                let permission = shared.settings().permission;
                let refused = if command.needs() > permission {
                    Some("not permitted: see the parameter control")
                } else if shared.settings().bag.is_some() {
                    Some("not possible: the view shows a bag")
                } else {
                    let asked = ClientCommand {
                        number,
                        command,
                        answers: answers.clone(),
                    };
                    let sent = shared.commands().try_send(asked);
                    sent.is_err().then_some("too many commands wait")
                };
                if let Some(reason) = refused {
                    answers.try_send(answer(Some(number), Err(reason))).ok();
                }
            }
            Message::Binary(_) => refuse(None, "not a command: it is binary; expected text")?,
            Message::Close(_) => break,
            Message::Ping(_) | Message::Pong(_) => {}
        }
    }
    Ok(())
}

/// The reply to a command; without a number if the message had none.
pub(crate) fn answer(number: Option<u32>, result: Result<&str, &str>) -> String {
    let (is_done, text) = match result {
        Ok(text) => (true, text),
        Err(text) => (false, text),
    };
    serde_json::json!({ "op": "answer", "number": number, "done": is_done, "text": text })
        .to_string()
}
