//! The coordinator's side of a worker: a thread that owns its connection.

use std::{
    net::{SocketAddr, TcpStream},
    sync::mpsc::{self, Receiver, RecvTimeoutError},
    time::{Duration, Instant},
};

use super::{
    connection::Connection,
    frame::{
        FrameError, Kind, read_header, read_magic, read_message, read_message_body, read_sums,
        write_job, write_magic, write_message,
    },
    message::{EndState, Message, quoted},
    order::{Job, Order, Reply},
    roster::Roster,
    shares::Measurement,
};
use crate::optimiser::differences;

/// Time for a message that has been received already.
const LAST_MESSAGE: Duration = Duration::from_millis(200);

/// End of a worker's connection.
enum End {
    /// With a notice for the user.
    Noticed(String),
    /// With the training.
    Training,
}

/// Serves a connection until its end.
pub fn serve(roster: &Roster, stream: TcpStream, address: SocketAddr) {
    let greeted = Connection::new(stream)
        .map_err(FrameError::from)
        .and_then(|connection| Ok((greet(roster, &connection)?, connection)));
    let (threads, connection) = match greeted {
        Ok((Ok(threads), connection)) => (threads, connection),
        Ok((Err(reason), _)) => {
            return roster.notice(format!(
                "refused a worker at {address}: {}",
                quoted(&reason)
            ));
        }
        Err(error) => {
            return roster.notice(format!("refused a connection from {address}: {error}"));
        }
    };
    let (orders, received) = mpsc::sync_channel(1);
    let worker = roster.add(address, threads, orders);
    let end = work(roster, &connection, worker, &received);
    roster.remove(worker);
    if let End::Noticed(notice) = end {
        roster.notice(format!("worker {address} {notice}"));
    }
}

/// The number of a worker's threads, or the reason why it is refused.
fn greet(roster: &Roster, connection: &Connection) -> Result<Result<usize, String>, FrameError> {
    let offer = &roster.offer;
    let mut stream = connection.within(roster.limits.greeting);
    read_magic(&mut stream)?;
    let hello = read_message(&mut stream)?;
    write_magic(&mut stream)?;
    let checked = match hello {
        Message::Hello { version, .. } if version != offer.version => Err(format!(
            "its version is {version}, expected {}",
            offer.version
        )),
        Message::Hello { threads: 0, .. } => Err("it has 0 threads".to_owned()),
        Message::Hello { threads, data, .. } => {
            let owners = ["of the coordinator", "of the worker"];
            match differences(&offer.data, &data, owners) {
                differences if differences.is_empty() => Ok(threads),
                differences => Err(format!(
                    "other data or another encoder:\n  {}",
                    differences.join("\n  ")
                )),
            }
        }
        _ => Err("its first message is not `hello`".to_owned()),
    };
    let answer = match &checked {
        Ok(_) => Message::Welcome {
            setup: offer.setup.clone(),
        },
        Err(reason) => Message::Refused {
            reason: reason.clone(),
        },
    };
    write_message(&mut stream, &answer)?;
    Ok(checked)
}

/// Obeys orders until the end of the connection.
fn work(roster: &Roster, connection: &Connection, worker: u64, orders: &Receiver<Order>) -> End {
    let lost = |error: FrameError| {
        End::Noticed(format!("is lost: {error}; the others compute its batches"))
    };
    loop {
        let limits = &roster.limits;
        match orders.recv_timeout(limits.ping) {
            Ok(Order::Compute(job)) => match compute(roster, connection, worker, &job) {
                Ok(Answer::Sums(reply)) => {
                    // Closed if the step has ended, which it does not before its jobs.
                    job.reply.send(reply).ok();
                }
                Ok(Answer::Left(notice)) => return End::Noticed(notice),
                Err(error) => return lost(error),
            },
            Ok(Order::Refuse(reason)) => {
                let refusal = Message::Refused {
                    reason: reason.clone(),
                };
                let mut stream = connection.within(limits.farewell);
                // The reason is printed here in any case.
                write_message(&mut stream, &refusal).ok();
                return End::Noticed(format!("is refused: {reason}"));
            }
            Err(RecvTimeoutError::Timeout) => {
                let mut stream = connection.within(limits.ping);
                if let Err(error) = write_message(&mut stream, &Message::Ping) {
                    return explained(connection, error).map_or_else(lost, End::Noticed);
                }
            }
            Err(RecvTimeoutError::Disconnected) => {
                let state = roster.end().unwrap_or(EndState::Failed);
                let mut stream = connection.within(limits.farewell);
                // A worker without the message waits for the coordinator for a while, then ends.
                write_message(&mut stream, &Message::End { state }).ok();
                return End::Training;
            }
        }
    }
}

/// A worker's answer to a job.
enum Answer {
    /// Its sums.
    Sums(Reply),
    /// It ended, with a notice.
    Left(String),
}

fn compute(
    roster: &Roster,
    connection: &Connection,
    worker: u64,
    job: &Job,
) -> Result<Answer, FrameError> {
    let begun = Instant::now();
    // In turn, so that the first workers compute while the others receive.
    let turn = job.is_share.then(|| roster.turn_to_send());
    let mut stream = connection.within(job.limit);
    let written = write_job(&mut stream, &job.part, &job.weights);
    drop(turn);
    if let Err(error) = written {
        return explained(connection, error).map(Answer::Left);
    }
    let header = read_header(&mut stream)?;
    if header.kind == Kind::Message {
        let message = read_message_body(&mut stream, header)?;
        return Ok(Answer::Left(notice(&message)));
    }
    let sizes: Vec<usize> = job.weights.iter().map(Vec::len).collect();
    let (seconds, nodes) = read_sums(&mut stream, header, &job.part, (&job.places, &sizes))?;
    let whole = begun.elapsed().as_secs_f64();
    // Of another process: it may be any number.
    let computation = if seconds > 0.0 {
        seconds.min(whole)
    } else {
        0.0
    };
    let measured = Measurement {
        batches: job.part.batches.len(),
        computation,
        transfer: whole - computation,
    };
    Ok(Answer::Sums(Reply {
        worker,
        nodes,
        measured,
    }))
}

/// The last message of a worker to which nothing can be written, or else the error.
fn explained(connection: &Connection, error: FrameError) -> Result<String, FrameError> {
    let message = read_message(&mut connection.within(LAST_MESSAGE));
    message.map(|message| notice(&message)).map_err(|_| error)
}

fn notice(message: &Message) -> String {
    match message {
        Message::Leave => "left; the others compute its batches".to_owned(),
        Message::Failed { reason } => format!("failed: {}", quoted(reason)),
        other => format!(
            "sent an unexpected message: {}",
            quoted(&format!("{other:?}"))
        ),
    }
}
