use std::{
    net::{TcpStream, ToSocketAddrs as _},
    ops::Range,
    time::{Duration, Instant},
};

use anyhow::{Context as _, Result, anyhow, bail};
use serde_json::Value;

use super::{
    connection::Connection,
    frame::{
        FrameError, Kind, Part, read_header, read_job, read_magic, read_message, read_message_body,
        write_magic, write_message, write_sums,
    },
    message::{EndState, Message, quoted},
};
use crate::{
    gradient_tree::Node,
    run::{RunEnd, Stop},
};

/// Time to connect to one address, and for the greeting.
const GREETING: Duration = Duration::from_secs(10);
/// Longest silence of a coordinator, which pings every five seconds.
const SILENCE: Duration = Duration::from_secs(30);
/// Time to send a result, or to receive a job that has begun.
const TRANSFER: Duration = Duration::from_secs(60);
/// Time between two attempts to connect.
const RETRY: Duration = Duration::from_secs(1);

/// Computes batches for a coordinator.
pub trait Computation {
    /// Numbers of values, by parameter.
    fn sizes(&self) -> Vec<usize>;

    /// Number of batches of a step.
    fn count(&self) -> usize;

    /// Sums of the batches `batches` of step `step` with `weights`, by place.
    ///
    /// # Errors
    /// If data or network fail.
    fn sums(&mut self, step: u64, batches: Range<usize>, weights: &[Vec<f32>])
    -> Result<Vec<Node>>;
}

/// A process that computes a share of each step.
#[derive(Clone, Debug)]
pub struct Worker {
    /// Address of the coordinator, which may be a host name.
    pub address: String,
    /// Version of the program.
    pub version: String,
    /// Number of threads.
    pub threads: usize,
    /// Description of the data.
    pub data: Value,
    /// How long to try to connect.
    pub wait: Duration,
}

/// A worker that a coordinator has accepted.
#[derive(Debug)]
pub struct Accepted<'a> {
    worker: &'a Worker,
    connection: Connection,
    /// Description of the computation.
    pub setup: String,
}

impl Worker {
    /// Connects to the coordinator, and repeats that for as long as the worker waits; `None` if `stop` is set.
    ///
    /// # Errors
    /// If the coordinator refuses this worker, is another program or stays unreachable.
    pub fn join(&self, stop: &Stop) -> Result<Option<Accepted<'_>>> {
        let begun = Instant::now();
        let mut is_noticed = false;
        loop {
            let error = match self.connect(stop) {
                Ok(connection) => match self.greet(connection)? {
                    Ok(accepted) => return Ok(Some(accepted)),
                    Err(error) => anyhow!(error),
                },
                Err(error) => error,
            };
            if stop.is_asked() {
                return Ok(None);
            }
            let (address, waited) = (&self.address, begun.elapsed());
            if waited >= self.wait {
                let waited = waited.as_secs();
                let context = format!("no coordinator at {address} for {waited} s");
                return Err(error.context(context));
            }
            if !std::mem::replace(&mut is_noticed, true) {
                let wait = self.wait.as_secs();
                println!("no coordinator at {address}: {error:#}; trying for {wait} s");
            }
            pause(stop);
        }
    }

    fn connect(&self, stop: &Stop) -> Result<Connection> {
        let addresses = self.address.to_socket_addrs();
        let mut last = anyhow!("the name has no address");
        for address in addresses.context("the name has no address")? {
            if stop.is_asked() {
                break;
            }
            match TcpStream::connect_timeout(&address, GREETING).and_then(Connection::new) {
                Ok(connection) => return Ok(connection),
                Err(error) => last = error.into(),
            }
        }
        Err(last)
    }

    /// The outer error is final; after the inner one, another attempt may succeed.
    fn greet(&self, connection: Connection) -> Result<Result<Accepted<'_>, FrameError>> {
        let exchange = || {
            let mut stream = connection.within(GREETING);
            write_magic(&mut stream)?;
            let hello = Message::Hello {
                version: self.version.clone(),
                threads: self.threads,
                data: self.data.clone(),
            };
            write_message(&mut stream, &hello)?;
            read_magic(&mut stream)?;
            read_message(&mut stream)
        };
        match exchange() {
            Ok(Message::Welcome { setup }) => {
                println!("joined the training at {}", self.address);
                Ok(Ok(Accepted {
                    worker: self,
                    connection,
                    setup,
                }))
            }
            Ok(other) => Err(self.refused(&other)),
            Err(error @ FrameError::Io(_)) => Ok(Err(error)),
            Err(error) => Err(error).with_context(|| self.address.clone()),
        }
    }

    fn refused(&self, message: &Message) -> anyhow::Error {
        let address = &self.address;
        match message {
            Message::Refused { reason } => {
                anyhow!("{address} refused this worker: {}", quoted(reason))
            }
            other => anyhow!("{address} sent {}", quoted(&format!("{other:?}"))),
        }
    }
}

impl Accepted<'_> {
    /// Computes batches until the training ends, `stop` is set, or the connection is lost (`None`).
    ///
    /// # Errors
    /// If the coordinator refuses this worker or ends with an error, or the computation fails.
    pub fn work(self, computation: &mut dyn Computation, stop: &Stop) -> Result<Option<RunEnd>> {
        let sizes = computation.sizes();
        let count = computation.count();
        let mut computed = 0;
        loop {
            let received = next(&self.connection, stop, &sizes);
            if stop.is_asked() {
                // The coordinator notices the end in any case.
                self.send(&Message::Leave).ok();
                return Ok(Some(RunEnd::Stopped));
            }
            let (part, weights) = match received {
                Ok(Received::Job(part, weights)) => (part, weights),
                Ok(Received::Message(Message::Ping)) => continue,
                Ok(Received::Message(Message::End { state })) => {
                    return self.ended(state, computed).map(Some);
                }
                Ok(Received::Message(other)) => return Err(self.worker.refused(&other)),
                Err(FrameError::Io(error)) => return Ok(self.lost(&error.into(), stop)),
                Err(error) => return Err(self.failed(error.into())),
            };
            let Part { step, batches } = &part;
            let begun = Instant::now();
            let sums = match batches.start < batches.end && batches.end <= count {
                true => computation.sums(*step, batches.clone(), &weights),
                false => Err(anyhow!("expected some of {count} batches, received {part}")),
            };
            let sums = sums.map_err(|error| self.failed(error))?;
            let sums = (begun.elapsed().as_secs_f64(), &sums[..]);
            if let Err(error) = write_sums(&mut self.connection.within(TRANSFER), &part, sums) {
                return Ok(self.lost(&error, stop));
            }
            computed += batches.len();
        }
    }

    fn send(&self, message: &Message) -> Result<(), FrameError> {
        write_message(&mut self.connection.within(RETRY), message)
    }

    fn lost(&self, error: &FrameError, stop: &Stop) -> Option<RunEnd> {
        println!("lost {}: {error}", self.worker.address);
        pause(stop);
        None
    }

    fn ended(&self, state: EndState, computed: usize) -> Result<RunEnd> {
        let address = &self.worker.address;
        println!("computed {computed} batches");
        match state {
            EndState::Finished => {
                println!("the training at {address} is finished");
                Ok(RunEnd::Finished)
            }
            EndState::Stopped => {
                println!(
                    "the training at {address} is stopped and saved; start both again to resume"
                );
                Ok(RunEnd::Stopped)
            }
            EndState::Failed => bail!("the training at {address} ended with an error"),
        }
    }

    /// Reports an error of this process to the coordinator, too.
    pub fn failed(&self, error: anyhow::Error) -> anyhow::Error {
        let reason = format!("{error:#}");
        // The error is printed here in any case.
        self.send(&Message::Failed { reason }).ok();
        error
    }
}

/// Waits before the next attempt.
fn pause(stop: &Stop) {
    let begun = Instant::now();
    while begun.elapsed() < RETRY && !stop.is_asked() {
        std::thread::sleep(RETRY / 10);
    }
}

enum Received {
    Message(Message),
    Job(Part, Vec<Vec<f32>>),
}

/// Waits for the next frame.
fn next(connection: &Connection, stop: &Stop, sizes: &[usize]) -> Result<Received, FrameError> {
    let header = read_header(&mut connection.within(SILENCE).or_stop(stop))?;
    let mut stream = connection.within(TRANSFER).or_stop(stop);
    match header.kind {
        Kind::Message => read_message_body(&mut stream, header).map(Received::Message),
        _ => {
            let (part, weights) = read_job(&mut stream, header, sizes)?;
            Ok(Received::Job(part, weights))
        }
    }
}
