//! Logs in ROS 2's format: `[INFO] [sec.nsec] [node]: text` on stderr, and the same record on `/rosout`.
//!
//! Control characters are escaped and long records cut, since they contain text of peers. Logging never waits for the
//! reader of stderr: without a reader, the oldest lines are dropped and counted.

#[cfg(feature = "zenoh")]
mod denials;
pub(crate) mod levels;
mod outlet;
pub(crate) mod panics;
pub(crate) mod printable;
mod record;

pub use outlet::Unblocked;
pub use printable::of_others;

use crate::{
    NodeArgs,
    backend::{WhenFull, WriteOutcome, Writer},
    clock::system_nanos,
    frame_trace,
    payload::Payload,
};
use outlet::{STDERR, STDOUT};
use printable::printable;
use record::Record;
use std::{
    cell::Cell,
    sync::{Arc, Mutex, PoisonError},
    time::Duration,
};
use tracing::{Event, Level, Subscriber, span};
use tracing_subscriber::{
    Layer,
    layer::{Context, SubscriberExt as _},
    registry::LookupSpan,
};
use wm_msgs::{builtin_interfaces::Time, cdr, rcl_interfaces::Log};

/// The nodes of this process and their publishers on `/rosout`.
static NODES: Mutex<Vec<Arc<Rosout>>> = Mutex::new(Vec::new());

thread_local! {
    /// Whether this thread is publishing on `/rosout`: the middleware's records meanwhile must not go there too.
    static IS_WRITING: Cell<bool> = const { Cell::new(false) };
}

/// A node's end of `/rosout`.
pub(crate) struct Rosout {
    /// `wm.encoder`
    logger: String,
    /// `None` with `--disable-rosout-logs`.
    writer: Option<Box<dyn Writer>>,
}

/// Ends a node's records on `/rosout` when it is dropped.
pub(crate) struct Registration(Arc<Rosout>);

impl Drop for Registration {
    fn drop(&mut self) {
        let mut nodes = NODES.lock().unwrap_or_else(PoisonError::into_inner);
        nodes.retain(|node| !Arc::ptr_eq(node, &self.0));
    }
}

/// Publishes further records of this node on its `/rosout`.
pub(crate) fn register(logger: String, writer: Option<Box<dyn Writer>>) -> Registration {
    let rosout = Arc::new(Rosout { logger, writer });
    NODES
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(Arc::clone(&rosout));
    Registration(rosout)
}

/// Writes the records of this process to stderr and `/rosout`, at the levels of the command line, until the service
/// `~/set_logger_levels` changes them. Only the first call has an effect; an installed subscriber stays.
pub fn init(args: &NodeArgs) {
    let filter = levels::install(&args.log_levels);
    let subscriber = tracing_subscriber::registry().with(RosLayer.with_filter(filter));
    tracing::subscriber::set_global_default(subscriber).ok();
}

/// How long the end of a process waits for the reader of its output.
const LAST_LINES: Duration = Duration::from_millis(500);

/// Standard error without blocking: lines wait in a queue if the pipe is full, and the oldest are dropped.
#[must_use]
pub fn stderr() -> Unblocked {
    Unblocked::new(&STDERR)
}

/// Standard output, likewise.
#[must_use]
pub fn stdout() -> Unblocked {
    Unblocked::new(&STDOUT)
}

/// Prints the result of a node on standard output, and waits at most half a second for its reader.
pub fn print(text: impl std::fmt::Display) {
    // stdout is closed: no reader is left
    STDOUT.push(text.to_string().into_bytes()).ok();
    STDOUT.flush(LAST_LINES);
}

/// Prints the reason for the end of the process as a line on standard error, and waits at most half a second for its
/// reader.
pub fn last_words(text: impl std::fmt::Display) {
    STDERR.push(format!("{text}\n").into_bytes()).ok();
    STDERR.flush(LAST_LINES);
}

/// Waits at most half a second until all output is written.
pub fn flush() {
    STDERR.flush(LAST_LINES);
    STDOUT.flush(LAST_LINES);
}

/// Returns the number of lines dropped since the last call.
pub(crate) fn take_dropped() -> u64 {
    STDERR.take_dropped() + STDOUT.take_dropped()
}

/// The node of a span.
struct NodeOfSpan(String);

struct RosLayer;

impl<S: Subscriber + for<'a> LookupSpan<'a>> Layer<S> for RosLayer {
    fn on_new_span(
        &self,
        attributes: &span::Attributes<'_>,
        id: &span::Id,
        context: Context<'_, S>,
    ) {
        let mut record = Record::default();
        attributes.record(&mut record);
        if let (Some(node), Some(span)) = (record.node, context.span(id)) {
            span.extensions_mut().insert(NodeOfSpan(node));
        }
    }

    fn on_event(&self, event: &Event<'_>, context: Context<'_, S>) {
        if IS_WRITING.get() {
            return;
        }
        let mut record = Record::default();
        event.record(&mut record);
        #[cfg(feature = "zenoh")]
        if event.metadata().target() == denials::TARGET {
            if let Some(warning) = denials::warning(&record.into_text()) {
                let target = denials::TARGET;
                write_line(&Level::WARN, system_nanos(), target, &warning);
            }
            return;
        }
        let text = printable(&record.into_text(), printable::RECORD);
        let stamp = system_nanos();
        let of_span = context.event_scope(event).and_then(|scope| {
            scope
                .filter_map(|span| span.extensions().get::<NodeOfSpan>().map(|n| n.0.clone()))
                .next()
        });
        let rosout = rosout_of(of_span.as_deref());
        let logger = match (&rosout, &of_span) {
            (Some(rosout), _) => rosout.logger.as_str(),
            (None, Some(node)) => node.as_str(),
            (None, None) => event.metadata().target(),
        };
        write_line(event.metadata().level(), stamp, logger, &text);
        if event.metadata().target() != frame_trace::TARGET
            && let Some(Rosout {
                logger,
                writer: Some(writer),
            }) = rosout.as_deref()
        {
            IS_WRITING.set(true);
            publish(&**writer, event, logger, text, stamp);
            IS_WRITING.set(false);
        }
    }
}

fn write_line(level: &Level, stamp: i64, logger: &str, text: &str) {
    let line = format!(
        "[{}] [{}] [{logger}]: {text}\n",
        name(level),
        seconds(stamp)
    );
    // stderr is closed: no reader is left
    STDERR.push(line.into_bytes()).ok();
}

/// The node of the event's span, or the only node of the process.
fn rosout_of(logger: Option<&str>) -> Option<Arc<Rosout>> {
    let nodes = NODES.lock().unwrap_or_else(PoisonError::into_inner);
    match (logger, &nodes[..]) {
        (Some(logger), nodes) => nodes.iter().find(|node| node.logger == logger).cloned(),
        (None, [only]) => Some(Arc::clone(only)),
        (None, _) => None,
    }
}

fn publish(writer: &dyn Writer, event: &Event<'_>, logger: &str, text: String, stamp: i64) {
    let metadata = event.metadata();
    let log = Log {
        stamp: Time::from_nanos(stamp),
        level: number(metadata.level()),
        name: logger.to_owned(),
        msg: text,
        file: metadata.file().unwrap_or_default().to_owned(),
        function: metadata.module_path().unwrap_or_default().to_owned(),
        line: metadata.line().unwrap_or_default(),
    };
    // The record is printed already; reporting the failure would make another record.
    if let Ok(bytes) = cdr::to_bytes(&log) {
        let payload = Payload::Cdr(bytes.into());
        let _: Result<WriteOutcome, _> = writer.write(&payload, None, WhenFull::DropOldest);
    }
}

fn seconds(nanos: i64) -> String {
    format!(
        "{}.{:09}",
        nanos.div_euclid(1_000_000_000),
        nanos.rem_euclid(1_000_000_000)
    )
}

fn name(level: &Level) -> &'static str {
    match *level {
        Level::ERROR => "ERROR",
        Level::WARN => "WARN",
        Level::INFO => "INFO",
        Level::DEBUG | Level::TRACE => "DEBUG",
    }
}

/// The numbers of `rcl_interfaces/msg/Log`.
fn number(level: &Level) -> u8 {
    match *level {
        Level::ERROR => 40,
        Level::WARN => 30,
        Level::INFO => 20,
        Level::DEBUG | Level::TRACE => 10,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stamps_have_nine_digits() {
        assert_eq!(seconds(1_700_000_000_000_000_042), "1700000000.000000042");
    }
}
