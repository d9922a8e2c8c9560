//! The configuration of sessions and routers, as `rmw_zenoh_cpp` reads it: a file (`ZENOH_SESSION_CONFIG_URI`,
//! `ZENOH_ROUTER_CONFIG_URI`) or the defaults, then `ZENOH_CONFIG_OVERRIDE`.
//!
//! The defaults are those of rmw_zenoh, except: a router listens on this host only, a message has at most 64 MiB, the
//! queues of a link are longer, and a malformed override is an error instead of a warning.

use super::{
    apart::{DroppedApart, apart},
    network::{LARGEST_MESSAGE, SAMPLE_QUEUES, WAITING_BATCHES},
    tls,
};
use crate::Error;
use serde_json::{Value, json};
use zenoh::{Config, Session, Wait as _};

/// How long a sample waits for a link that has no room \[us\], as Zenoh's default is for large samples. Its default for small
/// ones, 1 ms, drops those that follow a burst of large ones.
const LONGEST_WAIT_US: u32 = 50_000;

const OVERRIDE: &str = "ZENOH_CONFIG_OVERRIDE";
const ATTEMPTS: &str = "ZENOH_ROUTER_CHECK_ATTEMPTS";

/// The configuration of a node's session, from the process's environment variables: a peer that connects to the router
/// of this host, `tcp/localhost:7447`, and through it discovers the other peers of the host.
///
/// # Errors
/// An unreadable or invalid file, or an invalid override.
pub fn session_config() -> Result<Config, Error> {
    config("ZENOH_SESSION_CONFIG_URI", of_session(), &variable)
}

/// The configuration of a router, from the process's environment variables: it listens on `tcp/127.0.0.1:7447`.
///
/// # Errors
/// As [`session_config`].
pub fn router_config() -> Result<Config, Error> {
    config("ZENOH_ROUTER_CONFIG_URI", of_router(), &variable)
}

/// The configuration of a session that reaches only nodes of its own process.
pub(super) fn alone() -> Result<Config, Error> {
    let settings = [
        ("mode", json!("peer")),
        ("listen/endpoints", json!([])),
        ("scouting/multicast/enabled", json!(false)),
        ("scouting/gossip/enabled", json!(false)),
        ("timestamping/enabled", json!(true)),
    ];
    with(Config::default(), settings.into_iter())
}

/// A variable that has a value.
fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

type Settings = Vec<(&'static str, Value)>;

fn of_both() -> Settings {
    let mut settings = vec![
        ("scouting/multicast/enabled", json!(false)),
        (
            "scouting/gossip/target",
            json!({"router": ["router", "peer"], "peer": ["router"]}),
        ),
        ("timestamping/enabled", json!(true)),
        ("queries_default_timeout", json!(60_000)),
        ("transport/unicast/open_timeout", json!(60_000)),
        ("transport/unicast/accept_timeout", json!(60_000)),
        ("transport/unicast/accept_pending", json!(10_000)),
        ("transport/unicast/max_sessions", json!(10_000)),
        ("transport/link/tx/lease", json!(60_000)),
        ("transport/link/tx/keep_alive", json!(2)),
        ("transport/link/rx/max_message_size", json!(LARGEST_MESSAGE)),
        ("transport/shared_memory/enabled", json!(false)),
        (
            "transport/link/tx/queue/congestion_control/drop/wait_before_drop",
            json!(LONGEST_WAIT_US),
        ),
    ];
    let queues = SAMPLE_QUEUES.map(|key| (key, json!(WAITING_BATCHES)));
    settings.extend(queues);
    settings
}

fn of_session() -> Settings {
    let mut settings = of_both();
    settings.extend([
        ("mode", json!("peer")),
        ("connect/endpoints", json!(["tcp/localhost:7447"])),
        ("listen/endpoints", json!(["tcp/localhost:0"])),
        (
            "scouting/gossip/autoconnect",
            json!({"router": [], "peer": ["router", "peer"]}),
        ),
        (
            "scouting/gossip/autoconnect_strategy",
            json!({"peer": {"to_router": "always", "to_peer": "greater-zid"}}),
        ),
        (
            "transport/link/tx/queue/congestion_control/block/wait_before_close",
            json!(60_000_000),
        ),
    ]);
    settings
}

fn of_router() -> Settings {
    let mut settings = of_both();
    settings.extend([
        ("mode", json!("router")),
        // of a name with several addresses, Zenoh listens on the first free one: a second router would not notice the first
        ("listen/endpoints", json!(["tcp/127.0.0.1:7447"])),
    ]);
    settings
}

fn config(
    file_variable: &'static str,
    defaults: Settings,
    variable: &impl Fn(&str) -> Option<String>,
) -> Result<Config, Error> {
    let config = match variable(file_variable) {
        None => with(Config::default(), defaults.into_iter())?,
        Some(file) => Config::from_file(&file)
            .map_err(|error| invalid(file_variable, &file, &error.to_string()))?,
    };
    let Some(overrides) = variable(OVERRIDE) else {
        return Ok(config);
    };
    // an empty pair, for example after the last `;`, has no effect
    let pairs = overrides.split(';').filter(|pair| !pair.trim().is_empty());
    pairs.into_iter().try_fold(config, |mut config, pair| {
        let (key, value) = pair
            .split_once('=')
            .ok_or_else(|| invalid(OVERRIDE, pair, "key=value;key=value"))?;
        config
            .insert_json5(key.trim(), value)
            .map_err(|error| invalid(OVERRIDE, pair, &error.to_string()))?;
        Ok(config)
    })
}

fn with(
    mut config: Config,
    settings: impl Iterator<Item = (&'static str, Value)>,
) -> Result<Config, Error> {
    for (key, value) in settings {
        config
            .insert_json5(key, &value.to_string())
            .map_err(|error| Error::middleware(format!("set {key} of Zenoh to {value}"), error))?;
    }
    Ok(config)
}

fn invalid(variable: &'static str, value: &str, expected: &str) -> Error {
    Error::Environment {
        variable,
        value: value.to_owned(),
        expected: expected.to_owned(),
    }
}

/// How often a session looks for its router, once a second, before it warns; `None`: it does not look.
pub(super) fn router_check_attempts() -> Result<Option<u64>, Error> {
    attempts(variable(ATTEMPTS))
}

fn attempts(text: Option<String>) -> Result<Option<u64>, Error> {
    let Some(text) = text else {
        return Ok(Some(1));
    };
    match text.trim().parse::<i64>() {
        Ok(number) if number < 0 => Ok(None),
        Ok(0) => Ok(Some(u64::MAX)),
        Ok(number) => Ok(Some(number.unsigned_abs())),
        Err(_) => Err(invalid(ATTEMPTS, &text, "a number")),
    }
}

/// An open session.
pub(super) struct OwnSession(DroppedApart<Session>);

impl OwnSession {
    pub(super) fn open(config: Config) -> Result<Self, Error> {
        tls::warn(&config);
        let opened = apart(|| zenoh::open(config).wait())?;
        let session = opened.map_err(|error| Error::middleware("open a Zenoh session", error))?;
        Ok(Self(DroppedApart::new(session)))
    }

    /// # Errors
    /// It is closed, for good.
    pub(super) fn get(&self) -> Result<&Session, Error> {
        let session = self.0.get().filter(|session| !session.is_closed());
        session.ok_or_else(|| Error::ShutDown("the Zenoh session".to_owned()))
    }

    /// Sends what waits in its queues, and leaves.
    pub(super) fn close(&self) {
        let Ok(session) = self.get() else { return };
        let closed = apart(|| session.close().wait().map_err(|error| error.to_string()));
        if let Ok(Err(error)) = closed {
            tracing::debug!("the Zenoh session is not closed in order: {error}");
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn session(variables: &[(&str, &str)]) -> Result<Value, Error> {
        let variable = |name: &str| {
            let found = variables.iter().find(|(key, _)| *key == name);
            found.map(|(_, value)| (*value).to_owned())
        };
        let config = config("ZENOH_SESSION_CONFIG_URI", of_session(), &variable)?;
        Ok(serde_json::to_value(&config).unwrap())
    }

    #[test]
    fn defaults_are_those_of_rmw_zenoh() {
        let config = session(&[]).unwrap();
        for (pointer, expected) in [
            ("/mode", json!("peer")),
            ("/connect/endpoints", json!(["tcp/localhost:7447"])),
            ("/listen/endpoints", json!(["tcp/localhost:0"])),
            ("/scouting/multicast/enabled", json!(false)),
            ("/transport/shared_memory/enabled", json!(false)),
            ("/queries_default_timeout", json!(60_000)),
        ] {
            assert_eq!(config.pointer(pointer), Some(&expected), "{pointer}");
        }
        router_config().unwrap();
        alone().unwrap();
    }

    #[test]
    fn overrides_apply_to_defaults_and_files() {
        let value = "connect/endpoints=[\"tcp/10.0.0.7:7447\"];mode=\"client\";";
        let config = session(&[(OVERRIDE, value)]).unwrap();
        assert_eq!(config.pointer("/mode"), Some(&json!("client")));
        let endpoints = json!(["tcp/10.0.0.7:7447"]);
        assert_eq!(config.pointer("/connect/endpoints"), Some(&endpoints));

        let file = tempfile::Builder::new()
            .suffix(".json5")
            .tempfile()
            .unwrap();
        std::fs::write(file.path(), "{mode: 'router', /* mine */}").unwrap();
        let path = file.path().to_str().unwrap();
        let config = session(&[("ZENOH_SESSION_CONFIG_URI", path)]).unwrap();
        assert_eq!(config.pointer("/mode"), Some(&json!("router")));
    }

    #[test]
    fn invalid_variables_are_refused_by_name() {
        let refused = |variable, value| session(&[(variable, value)]).unwrap_err().to_string();
        let text = refused(OVERRIDE, "mode");
        assert_eq!(
            text,
            "ZENOH_CONFIG_OVERRIDE is `mode`: expected key=value;key=value"
        );
        assert!(refused(OVERRIDE, "mode=\"boss\"").starts_with("ZENOH_CONFIG_OVERRIDE is `mode="));
        let text = refused("ZENOH_SESSION_CONFIG_URI", "/nowhere.json5");
        assert!(
            text.starts_with("ZENOH_SESSION_CONFIG_URI is `/nowhere.json5`"),
            "{text}"
        );
    }

    #[test]
    fn attempts_are_as_in_rmw_zenoh() {
        let of = |text: &str| attempts(Some(text.to_owned())).unwrap();
        assert_eq!(attempts(None).unwrap(), Some(1));
        assert_eq!(
            [of("0"), of("3"), of("-1")],
            [Some(u64::MAX), Some(3), None]
        );
        assert!(attempts(Some("x".to_owned())).is_err());
    }
}
