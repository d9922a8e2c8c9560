//! The configuration and the session.
//!
//! Unlike Zenoh's own defaults, a program connects to and accepts only hosts that the user names: without `--listen` it
//! listens on this host only, or not at all if it connects somewhere. It neither scouts by multicast nor connects to
//! addresses that others announce. Settings in the configuration file take precedence.

use super::tls;
use anyhow::{Result, anyhow};
use clap::ValueEnum;
use serde_json::{Value, json};
use std::path::PathBuf;

/// Zenoh's own port, on this host.
const LOCAL_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// The largest accepted message \[byte\], instead of Zenoh's 1 GiB: twice a raw picture of 4096 x 2160.
pub(super) const LARGEST_MESSAGE: usize = 64 << 20;

/// Batches of 64 KiB that wait for a link, per priority: Zenoh's maximum, instead of its 2. Repeated packet loss stalls
/// TCP for seconds, and a burst of samples fills 128 KiB in a few milliseconds; further samples are dropped. Memory is
/// allocated on demand.
pub(super) const WAITING_BATCHES: usize = 16;
pub(super) const SAMPLE_QUEUES: [&str; 7] = [
    "transport/link/tx/queue/size/real_time",
    "transport/link/tx/queue/size/interactive_high",
    "transport/link/tx/queue/size/interactive_low",
    "transport/link/tx/queue/size/data_high",
    "transport/link/tx/queue/size/data",
    "transport/link/tx/queue/size/data_low",
    "transport/link/tx/queue/size/background",
];

/// The role in the Zenoh network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Mode {
    /// Forwards what others exchange; the others connect to it
    Router,
    /// Exchanges only with those that it is connected to
    Peer,
    /// Connects to only one router or peer
    Client,
}

impl Mode {
    fn name(self) -> &'static str {
        match self {
            Self::Router => "router",
            Self::Peer => "peer",
            Self::Client => "client",
        }
    }
}

/// Where a program connects and listens.
#[derive(Clone, Debug, Default, clap::Args)]
pub struct NetworkArguments {
    /// Zenoh's configuration file (JSON5): TLS, access control, endpoints; for the bridge also the section plugins/ros2dds
    #[arg(short, long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Role in the Zenoh network [default: router]
    #[arg(short, long)]
    pub mode: Option<Mode>,
    /// Connect here, for example tcp/robot.local:7447 or quic/10.0.0.7:7447 (repeatable)
    #[arg(short = 'e', long, value_name = "ENDPOINT")]
    pub connect: Vec<String>,
    /// Let others connect here, for example tcp/0.0.0.0:7447 (repeatable) [default: tcp/127.0.0.1:7447, or none with
    /// --connect]
    #[arg(short, long, value_name = "ENDPOINT")]
    pub listen: Vec<String>,
    /// Discover other Zenoh nodes by multicast, and be discovered
    #[arg(long)]
    pub scout: bool,
}

impl NetworkArguments {
    /// The configuration of the session.
    ///
    /// # Errors
    /// The file cannot be read or is malformed, or an option is invalid.
    pub fn resolve(&self) -> Result<zenoh::Config> {
        let mut config = match &self.config {
            None => zenoh::Config::default(),
            Some(file) => zenoh::Config::from_file(file)
                .map_err(|error| anyhow!("{}: {error}", file.display()))?,
        };
        let given = serde_json::to_value(&config)?;
        for (key, value) in self.values(&given)? {
            config
                .insert_json5(key, &value.to_string())
                .map_err(|error| anyhow!("{key} = {value}: {error}"))?;
        }
        Ok(config)
    }

    /// The settings from the options, and the safe defaults.
    fn values(&self, given: &Value) -> Result<Vec<(&'static str, Value)>> {
        let defaults = serde_json::to_value(zenoh::Config::default())?;
        let is_unset = |key: &str| {
            let pointer = format!("/{key}");
            given.pointer(&pointer) == defaults.pointer(&pointer)
        };
        let mut values = Vec::new();
        if let Some(mode) = self.mode {
            values.push(("mode", json!(mode.name())));
        } else if is_unset("mode") {
            values.push(("mode", json!(Mode::Router.name())));
        }
        let is_connecting = !self.connect.is_empty() || !is_unset("connect/endpoints");
        if !self.connect.is_empty() {
            values.push(("connect/endpoints", json!(self.connect)));
        }
        if !self.listen.is_empty() {
            values.push(("listen/endpoints", json!(self.listen)));
        } else if is_unset("listen/endpoints") {
            let local: &[&str] = if is_connecting {
                &[]
            } else {
                &[LOCAL_ENDPOINT]
            };
            values.push(("listen/endpoints", json!(local)));
        }
        if self.scout {
            values.push(("scouting/multicast/enabled", json!(true)));
        } else {
            if is_unset("scouting/multicast/enabled") {
                values.push(("scouting/multicast/enabled", json!(false)));
            }
            if is_unset("scouting/gossip/autoconnect") {
                let nobody = json!({"router": [], "peer": [], "client": []});
                values.push(("scouting/gossip/autoconnect", nobody));
            }
        }
        if is_unset("transport/link/rx/max_message_size") {
            let largest = json!(LARGEST_MESSAGE);
            values.push(("transport/link/rx/max_message_size", largest));
        }
        for key in SAMPLE_QUEUES {
            if is_unset(key) {
                values.push((key, json!(WAITING_BATCHES)));
            }
        }
        if is_unset("timestamping/enabled") {
            // latched topics are kept by time
            values.push(("timestamping/enabled", json!(true)));
        }
        Ok(values)
    }
}

/// Opens the session.
///
/// # Errors
/// An endpoint cannot be listened on, or in client mode not be connected to.
pub async fn open(config: zenoh::Config) -> Result<zenoh::Session> {
    tls::warn(&config);
    let session = zenoh::open(config)
        .await
        .map_err(|error| anyhow!("cannot open the Zenoh session: {error}"))?;
    Ok(session)
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::io::Write as _;

    fn resolved(arguments: &NetworkArguments) -> Value {
        let config = arguments.resolve().unwrap();
        serde_json::to_value(&config).unwrap()
    }

    fn words(words: &[&str]) -> Vec<String> {
        words.iter().map(ToString::to_string).collect()
    }

    #[test]
    fn default_listens_on_this_host_and_connects_nowhere() {
        let config = resolved(&NetworkArguments::default());
        assert_eq!(config.pointer("/mode"), Some(&json!("router")));
        assert_eq!(
            config.pointer("/listen/endpoints"),
            Some(&json!([LOCAL_ENDPOINT]))
        );
        assert_eq!(config.pointer("/connect/endpoints"), Some(&json!([])));
        assert_eq!(
            config.pointer("/scouting/multicast/enabled"),
            Some(&json!(false))
        );
        assert_eq!(
            config.pointer("/transport/link/rx/max_message_size"),
            Some(&json!(LARGEST_MESSAGE))
        );
        for key in SAMPLE_QUEUES {
            let batches = config.pointer(&format!("/{key}"));
            assert_eq!(batches, Some(&json!(WAITING_BATCHES)), "{key}");
        }
        for mode in ["router", "peer"] {
            let pointer = format!("/scouting/gossip/autoconnect/{mode}");
            assert_eq!(config.pointer(&pointer), Some(&json!([])), "{config}");
        }
    }

    #[test]
    fn connecting_program_listens_only_on_request() {
        let mut arguments = NetworkArguments {
            connect: words(&["tcp/10.0.0.7:7447"]),
            ..NetworkArguments::default()
        };
        let config = resolved(&arguments);
        assert_eq!(
            config.pointer("/connect/endpoints"),
            Some(&json!(["tcp/10.0.0.7:7447"]))
        );
        assert_eq!(config.pointer("/listen/endpoints"), Some(&json!([])));
        arguments.listen = words(&["tcp/0.0.0.0:7448"]);
        let config = resolved(&arguments);
        assert_eq!(
            config.pointer("/listen/endpoints"),
            Some(&json!(["tcp/0.0.0.0:7448"]))
        );
    }

    #[test]
    fn options_override_the_file_and_the_file_overrides_defaults() {
        let mut file = tempfile::Builder::new()
            .suffix(".json5")
            .tempfile()
            .unwrap();
        let text = r#"{ mode: "peer", listen: { endpoints: ["tls/0.0.0.0:7447"] },
            access_control: { enabled: true, default_permission: "deny" } }"#;
        file.write_all(text.as_bytes()).unwrap();
        let mut arguments = NetworkArguments {
            config: Some(file.path().to_owned()),
            ..NetworkArguments::default()
        };
        let config = resolved(&arguments);
        assert_eq!(config.pointer("/mode"), Some(&json!("peer")));
        assert_eq!(
            config.pointer("/listen/endpoints"),
            Some(&json!(["tls/0.0.0.0:7447"]))
        );
        assert_eq!(
            config.pointer("/access_control/enabled"),
            Some(&json!(true))
        );
        arguments.mode = Some(Mode::Client);
        assert_eq!(
            resolved(&arguments).pointer("/mode"),
            Some(&json!("client"))
        );
    }

    #[test]
    fn faults_are_named() {
        let missing = NetworkArguments {
            config: Some("/nonexistent.json5".into()),
            ..NetworkArguments::default()
        };
        let error = missing.resolve().unwrap_err().to_string();
        assert!(error.contains("/nonexistent.json5"), "{error}");
        let malformed = NetworkArguments {
            connect: words(&["robot"]),
            ..NetworkArguments::default()
        };
        let error = malformed.resolve().unwrap_err().to_string();
        assert!(error.contains("robot"), "{error}");
    }
}
