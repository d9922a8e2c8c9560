//! Errors of the runtime. Each names the expected and the actual value.

use crate::{GoalId, args::ArgsError, parameters::ParameterError};
use wm_msgs::cdr::CdrError;

/// An error of the runtime.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// The command line.
    #[error(transparent)]
    Args(#[from] ArgsError),
    /// A parameter.
    #[error(transparent)]
    Parameter(#[from] ParameterError),
    /// A message without a CDR form, or bytes of another type.
    #[error(transparent)]
    Cdr(#[from] CdrError),
    /// A name that ROS does not allow.
    #[error("`{name}` is not a valid {kind} name: {reason}")]
    Name {
        /// The name, after expansion.
        name: String,
        /// The kind: topic, service, node, namespace or type.
        kind: &'static str,
        /// The rule that it breaks.
        reason: String,
    },
    /// Two nodes of one process with the same name.
    #[error("two nodes have the name {0}: give each its own name with -r NODE:__node:=NAME")]
    SameName(String),
    /// An invalid environment variable or `--interface`.
    #[error("{variable} is `{value}`: expected {expected}")]
    Environment {
        /// The variable or flag.
        variable: &'static str,
        /// Its value.
        value: String,
        /// The valid values.
        expected: String,
    },
    /// DDS security is requested and enforced, and this build has none.
    #[error(
        "ROS_SECURITY_ENABLE is `true` and ROS_SECURITY_STRATEGY is `Enforce`, but DDS security (SROS 2) is not built in: \
         the node does not start; use Zenoh with TLS instead: `wm keys DIR` makes its files, then --middleware zenoh and \
         ZENOH_SESSION_CONFIG_URI=DIR/NODE.json5 (docs/security.md)"
    )]
    NoSecurity,
    /// The middleware is Zenoh, and this build has none.
    #[error(
        "the middleware is Zenoh (--middleware zenoh, or RMW_IMPLEMENTATION=rmw_zenoh_cpp), but this program is built \
         without it: build it with `--features zenoh`, or use DDS"
    )]
    NoZenoh,
    /// Zenoh connects only endpoints whose types have the same hash.
    #[error(
        "cannot make {endpoint}: Zenoh needs the hash of its type {type_name}, which is unknown"
    )]
    NoTypeHash {
        /// The topic or service.
        endpoint: String,
        /// Its type.
        type_name: String,
    },
    /// Security is requested and enforced, and the Zenoh session permits a connection without it.
    #[error(
        "ROS_SECURITY_STRATEGY is `Enforce`, but {setting} of the Zenoh session is `{found}`: expected {expected}; set \
         ZENOH_SESSION_CONFIG_URI to a file of `wm keys` (docs/security.md)"
    )]
    InsecureSession {
        /// The path of the setting.
        setting: String,
        /// Its value.
        found: String,
        /// The secured value.
        expected: &'static str,
    },
    /// All participant numbers are in use.
    #[error(
        "DDS domain {domain} is full on this host: all {participants} participants that it can have exist; end some \
         nodes, run several in one process (`wm run NODE NODE ...`), or set another ROS_DOMAIN_ID for some"
    )]
    DomainFull {
        /// `ROS_DOMAIN_ID`.
        domain: u16,
        /// The most participants of the domain on one host.
        participants: u16,
    },
    /// An interface has changed its address since the start, or has lost it for a while.
    #[error(
        "the address of {interface} has changed from {before} to {now}: the DDS library is bound to the old one; \
         restart the node"
    )]
    AddressChanged {
        /// Its name.
        interface: String,
        /// The address at the start.
        before: std::net::IpAddr,
        /// The address now.
        now: std::net::IpAddr,
    },
    /// The middleware refused or failed.
    #[error("cannot {action}: {reason}")]
    Middleware {
        /// The attempted action.
        action: String,
        /// The middleware's error.
        reason: String,
    },
    /// Bytes that this middleware cannot send.
    #[error(
        "cannot publish on {topic}: expected little-endian CDR (0x0001), got 0x{representation:04x}"
    )]
    Representation {
        /// The topic.
        topic: String,
        /// The first two bytes of the sample.
        representation: u16,
    },
    /// An answer larger than one datagram, which this middleware cannot send.
    #[error("cannot answer on {service}: {len} bytes, at most {largest} fit into one datagram")]
    AnswerTooLarge {
        /// The service.
        service: String,
        /// Size of the answer \[byte\].
        len: usize,
        /// The largest that can be sent \[byte\].
        largest: usize,
    },
    /// A message larger than this middleware can send.
    #[error("cannot publish {topic}: {len} bytes, at most {largest} can be sent")]
    MessageTooLarge {
        /// The topic.
        topic: String,
        /// Size of the message \[byte\].
        len: usize,
        /// The largest that can be sent \[byte\].
        largest: usize,
    },
    /// The middleware has failed.
    #[error(
        "the DDS library has ended, as it does when its process is stopped and continued (SIGSTOP, Ctrl-Z, a \
         debugger): restart the node"
    )]
    MiddlewareEnded,
    /// The Zenoh session has ended although the node runs.
    #[error("the Zenoh session has ended: restart the node")]
    SessionEnded,
    /// A thread of the process has panicked.
    #[error("{0}")]
    ThreadPanicked(String),
    /// A task that receives or sends for all nodes of the process has panicked.
    #[error(
        "the task `{task}` has panicked: {message}; the node cannot continue: restart it, and report this"
    )]
    Panicked {
        /// The purpose of the task.
        task: &'static str,
        /// The panic's message.
        message: String,
    },
    /// The system's clock was set back; rustdds' best-effort readers receive nothing for that time.
    #[error(
        "the system's clock was set back by {by:.1?}: the DDS library would drop everything it receives for as long: \
         restart the node"
    )]
    ClockStepped {
        /// By this much.
        by: std::time::Duration,
    },
    /// The context was closed, or the process is being shut down.
    #[error("{0} is over: the context is shut down")]
    ShutDown(String),
    /// A goal of an action that is rejected or unknown.
    #[error("the goal {id} of {action}: {reason}")]
    Goal {
        /// The action.
        action: String,
        /// The goal.
        id: GoalId,
        /// The reason.
        reason: &'static str,
    },
    /// The operating system.
    #[error("cannot {action}: {reason}")]
    Io {
        /// The attempted action.
        action: String,
        /// The system's error. Not the `source`, since the message contains it.
        reason: std::io::Error,
    },
}

impl Error {
    /// Whether the cause is the user's arguments or parameters, not a later failure.
    #[must_use]
    pub fn is_usage(&self) -> bool {
        match self {
            Self::Args(_) | Self::SameName(_) => true,
            Self::Parameter(problem) => problem.is_usage(),
            _ => false,
        }
    }

    pub(crate) fn middleware(action: impl Into<String>, reason: impl std::fmt::Display) -> Self {
        Self::Middleware {
            action: action.into(),
            reason: reason.to_string(),
        }
    }

    pub(crate) fn io(action: impl Into<String>, reason: std::io::Error) -> Self {
        Self::Io {
            action: action.into(),
            reason,
        }
    }
}
