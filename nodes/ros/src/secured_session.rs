//! Whether a Zenoh session authenticates and encrypts each of its connections, as `ROS_SECURITY_STRATEGY=Enforce`
//! requires.

use crate::Error;
use serde_json::Value;

/// The protocols with TLS.
const PROTOCOLS: [&str; 2] = ["tls", "quic"];

/// Checks that the session connects by TLS alone, with certificates on both sides.
///
/// Zenoh does not show the certificates inside a configuration; a session with `enable_mtls` fails without its own.
///
/// # Errors
/// The first setting that permits another connection.
pub(crate) fn check(config: &zenoh::Config) -> Result<(), Error> {
    let config = serde_json::to_value(config)
        .map_err(|error| Error::middleware("read the Zenoh configuration", error))?;
    let protocols = texts(config.pointer("/transport/link/protocols"));
    let is_secured = |text: &String| PROTOCOLS.contains(&&**text);
    expect(
        "transport/link/protocols",
        !protocols.is_empty() && protocols.iter().all(is_secured),
        &protocols.join(", "),
        "tls or quic only",
    )?;
    let tls = |setting: &str| config.pointer(&format!("/transport/link/tls/{setting}"));
    for (setting, is_default) in [("enable_mtls", false), ("verify_name_on_connect", true)] {
        let value = tls(setting).and_then(Value::as_bool);
        let path = format!("transport/link/tls/{setting}");
        let is_set = value.unwrap_or(is_default);
        expect(&path, is_set, &is_set.to_string(), "true")?;
    }
    // an endpoint may have settings of its own after `#`
    for list in ["connect/endpoints", "listen/endpoints"] {
        for endpoint in texts(config.pointer(&format!("/{list}"))) {
            let is_free = !endpoint.contains("enable_mtls") && !endpoint.contains("verify_name");
            let expected = "an endpoint without TLS settings of its own";
            expect(list, is_free, &endpoint, expected)?;
        }
    }
    Ok(())
}

fn expect(setting: &str, is_so: bool, found: &str, expected: &'static str) -> Result<(), Error> {
    match is_so {
        true => Ok(()),
        false => Err(Error::InsecureSession {
            setting: setting.to_owned(),
            found: found.to_owned(),
            expected,
        }),
    }
}

/// All texts in the value, at any depth: Zenoh accepts a list, or one for each mode.
pub(crate) fn texts(value: Option<&Value>) -> Vec<String> {
    match value {
        Some(Value::String(text)) => vec![text.clone()],
        Some(Value::Array(values)) => values.iter().flat_map(|value| texts(Some(value))).collect(),
        Some(Value::Object(values)) => values
            .values()
            .flat_map(|value| texts(Some(value)))
            .collect(),
        _ => Vec::new(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SECURED: &str = r#"{
        mode: "client", connect: { endpoints: ["quic/localhost:7447"] }, listen: { endpoints: [] },
        transport: { link: { protocols: ["quic"], tls: { enable_mtls: true, verify_name_on_connect: true } } },
    }"#;

    fn checked(from: &str, to: &str) -> Result<(), String> {
        assert!(SECURED.contains(from), "{from}");
        let text = SECURED.replace(from, to);
        let config = zenoh::Config::from_json5(&text).unwrap();
        check(&config).map_err(|error| error.to_string())
    }

    #[test]
    fn only_authenticated_connections_pass() {
        assert_eq!(checked("", ""), Ok(()));
        for (from, to, setting) in [
            ("[\"quic\"]", "[\"quic\", \"tcp\"]", "protocols"),
            ("protocols: [\"quic\"], ", "", "protocols"),
            ("enable_mtls: true, ", "", "enable_mtls"),
            ("enable_mtls: true", "enable_mtls: false", "enable_mtls"),
            ("connect: true", "connect: false", "verify_name_on_connect"),
            (
                ":7447",
                ":7447#verify_name_on_connect=false",
                "connect/endpoints",
            ),
        ] {
            let error = checked(from, to).unwrap_err();
            assert!(error.contains(setting), "{to}: {error}");
        }
    }

    #[test]
    fn session_without_a_file_is_refused() {
        assert!(check(&zenoh::Config::default()).is_err());
    }
}
