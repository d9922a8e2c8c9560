//! Zenoh's links by TLS over TCP are unsound.

use crate::secured_session::texts;
use zenoh::Config;

/// Warns of links by TLS over TCP.
///
/// Zenoh 1.10 reads and writes the same TLS connection on two threads at once (eclipse-zenoh/zenoh#2557). Under load, links
/// break and messages are lost, nodes hang when they start, and programs crash. QUIC takes the same certificates, and has
/// a stream for each direction.
pub(super) fn warn(config: &Config) {
    for endpoint in endpoints(config) {
        tracing::warn!(
            "{endpoint}: links by TLS over TCP break and crash under load (eclipse-zenoh/zenoh#2557): use quic/ instead of \
             tls/ on both sides, with the same certificates"
        );
    }
}

/// The endpoints that are connected to or listened on by TLS over TCP.
fn endpoints(config: &Config) -> Vec<String> {
    // a configuration is made of JSON, and is JSON again
    let config = serde_json::to_value(config).unwrap_or_default();
    let lists = ["/connect/endpoints", "/listen/endpoints"];
    let endpoints = lists.iter().flat_map(|list| texts(config.pointer(list)));
    endpoints
        .filter(|endpoint| endpoint.starts_with("tls/"))
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn endpoints_of_every_mode_are_found() {
        let config = Config::from_json5(
            r#"{ connect: { endpoints: ["quic/robot.local:7447", "tls/robot.local:7447"] },
                 listen: { endpoints: { router: ["tls/[::]:7447"], peer: ["tcp/localhost:0"] } } }"#,
        );
        let found = endpoints(&config.unwrap());
        assert_eq!(found, ["tls/robot.local:7447", "tls/[::]:7447"]);
        assert!(endpoints(&Config::default()).is_empty());
    }
}
