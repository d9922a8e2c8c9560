//! The configuration of the router: rmw_zenohd's settings or a file, then `ZENOH_CONFIG_OVERRIDE`, then the options.

use super::ZenohRouterCommand;
use anyhow::{Result, anyhow, bail};
use serde_json::{Value, json};

/// Where programs look for the router of their host, as rmw_zenoh names it. Of a name with several addresses, Zenoh
/// listens on the first free one, and a second router would not notice the first. So the router gets an address.
const LOCAL_NAME: &str = "tcp/localhost:7447";
const LOCAL_ENDPOINT: &str = "tcp/127.0.0.1:7447";

/// The configuration from the options and the environment.
///
/// # Errors
/// The file cannot be read, a setting is invalid, or the result is not a router.
pub(super) fn resolve(command: &ZenohRouterCommand) -> Result<zenoh::Config> {
    completed(wm_ros::zenoh::router_config()?, command)
}

fn completed(mut config: zenoh::Config, command: &ZenohRouterCommand) -> Result<zenoh::Config> {
    let options = [
        ("connect/endpoints", &command.connect),
        ("listen/endpoints", &command.listen),
    ];
    for (key, endpoints) in options {
        if !endpoints.is_empty() {
            insert(&mut config, key, endpoints)?;
        }
    }
    // a file without addresses would open the router to every network
    let unset = setting(&zenoh::Config::default(), "/listen/endpoints")?;
    if [json!([LOCAL_NAME]), unset].contains(&setting(&config, "/listen/endpoints")?) {
        insert(
            &mut config,
            "listen/endpoints",
            &[LOCAL_ENDPOINT.to_owned()],
        )?;
    }
    match setting(&config, "/mode")? {
        Value::String(mode) if mode == "router" => Ok(config),
        other => bail!(
            "a router needs the mode \"router\", got {other}: check ZENOH_ROUTER_CONFIG_URI, and ZENOH_CONFIG_OVERRIDE, \
             which applies to all programs"
        ),
    }
}

fn insert(config: &mut zenoh::Config, key: &str, endpoints: &[String]) -> Result<()> {
    let value = json!(endpoints).to_string();
    config
        .insert_json5(key, &value)
        .map_err(|error| anyhow!("{key} = {value}: {error}"))
}

fn setting(config: &zenoh::Config, pointer: &str) -> Result<Value> {
    let value = serde_json::to_value(config)?;
    Ok(value.pointer(pointer).cloned().unwrap_or_default())
}

/// The endpoints that the router listens on.
pub(super) fn listening(config: &zenoh::Config) -> Result<Vec<String>> {
    let endpoints = match setting(config, "/listen/endpoints")? {
        Value::Object(by_mode) => by_mode.get("router").cloned().unwrap_or(json!([])),
        other => other,
    };
    Ok(serde_json::from_value(endpoints)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn config(text: &str) -> zenoh::Config {
        zenoh::Config::from_json5(text).unwrap()
    }

    fn endpoints(text: &str, command: &ZenohRouterCommand) -> Vec<String> {
        listening(&completed(config(text), command).unwrap()).unwrap()
    }

    #[test]
    fn router_listens_on_loopback_by_default() {
        let command = ZenohRouterCommand::default();
        let local = [LOCAL_ENDPOINT];
        assert_eq!(endpoints("{mode: 'router'}", &command), local);
        let named = "{mode: 'router', listen: {endpoints: ['tcp/localhost:7447']}}";
        assert_eq!(endpoints(named, &command), local);
        let chosen = "{mode: 'router', listen: {endpoints: ['tcp/[::]:7447']}}";
        assert_eq!(endpoints(chosen, &command), ["tcp/[::]:7447"]);
    }

    #[test]
    fn options_precede_the_configuration() {
        let command = ZenohRouterCommand {
            connect: vec!["tcp/robot.local:7447".to_owned()],
            listen: vec!["tcp/[::]:7003".to_owned()],
            ..ZenohRouterCommand::default()
        };
        let text = "{mode: 'router', listen: {endpoints: ['tcp/[::]:7001']}}";
        assert_eq!(endpoints(text, &command), ["tcp/[::]:7003"]);
        let config = completed(config(text), &command).unwrap();
        let connect = setting(&config, "/connect/endpoints").unwrap();
        assert_eq!(connect, json!(["tcp/robot.local:7447"]));
    }

    #[test]
    fn other_modes_and_malformed_endpoints_are_refused() {
        let refused = |text: &str, command: &ZenohRouterCommand| {
            completed(config(text), command).unwrap_err().to_string()
        };
        let client = refused("{mode: 'client'}", &ZenohRouterCommand::default());
        assert!(client.contains("\"client\""), "{client}");
        let command = ZenohRouterCommand {
            listen: vec!["robot".to_owned()],
            ..ZenohRouterCommand::default()
        };
        let malformed = refused("{mode: 'router'}", &command);
        assert!(malformed.contains("robot"), "{malformed}");
    }
}
