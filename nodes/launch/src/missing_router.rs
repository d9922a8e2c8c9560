//! Finds out whether a launch starts a Zenoh router for its processes: their host has none.
//!
//! Programs with the middleware zenoh find each other through the router of their host, at tcp/localhost:7447 unless
//! `ZENOH_CONFIG_OVERRIDE` specifies another address. A program with a configuration file of its own
//! (`ZENOH_SESSION_CONFIG_URI`), or with an address of another host, gets no router: the user runs it.

use super::plan::{Output, Plan, Process, Program, Router, Surroundings};
use std::collections::BTreeMap;
use std::net::ToSocketAddrs as _;
use std::time::Duration;

/// The subcommand of this program that is the router.
const COMMAND: &str = "zenoh-router";
/// The router's address, unless specified: the default of rmw_zenoh_cpp.
const ADDRESS: &str = "localhost:7447";

const OVERRIDE: &str = "ZENOH_CONFIG_OVERRIDE";
const SESSION_FILE: &str = "ZENOH_SESSION_CONFIG_URI";
/// Settings of `ZENOH_CONFIG_OVERRIDE` that are meant for programs, not for their router.
const OF_SESSIONS: [&str; 3] = ["mode", "connect/endpoints", "listen/endpoints"];

/// ROS 2's variable, and its value for Zenoh.
const MIDDLEWARE: (&str, &str) = ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp");
/// The option of the nodes that takes precedence.
const OPTION: &str = "--middleware";

/// The router handles its end in milliseconds.
const STOP_TIMEOUT: Duration = Duration::from_secs(5);

/// The router that `plan` needs: one of its processes uses Zenoh with a router on this host, and none runs.
#[must_use]
pub fn missing_router(plan: &Plan, surroundings: &dyn Surroundings) -> Option<Router> {
    needed_router(plan, surroundings).filter(|router| !router.is_running())
}

fn needed_router(plan: &Plan, surroundings: &dyn Surroundings) -> Option<Router> {
    let uses = |process: &&Process| Variables(process, surroundings).uses_zenoh();
    let process = plan.processes.iter().find(uses)?;
    let variables = Variables(process, surroundings);
    if variables.get(SESSION_FILE).is_some() {
        return None;
    }
    let text = variables.get(OVERRIDE).unwrap_or_default();
    let settings: BTreeMap<&str, &str> = settings(&text).collect();
    let specified = match settings.get("connect/endpoints") {
        None => None,
        Some(endpoints) => Some(local_address(endpoints)?),
    };
    let addresses = specified.as_deref().unwrap_or(ADDRESS).to_socket_addrs();
    let addresses: Vec<_> = addresses.ok()?.collect();
    let mut arguments = vec![COMMAND.to_owned()];
    // without an address, the router's own settings hold
    if specified.is_some() {
        let address = addresses.iter().find(|address| address.is_ipv4());
        let address = address.or_else(|| addresses.first())?;
        arguments.extend(["--listen".to_owned(), format!("tcp/{address}")]);
    }
    let of_router = settings
        .iter()
        .filter(|(key, _)| !OF_SESSIONS.contains(key))
        .map(|(key, value)| format!("{key}={value}"));
    let of_router = of_router.collect::<Vec<_>>().join(";");
    let mut environment = process.environment.clone();
    environment.push((
        OVERRIDE.to_owned(),
        Some(of_router).filter(|text| !text.is_empty()),
    ));
    Some(Router {
        addresses,
        process: Process {
            name: COMMAND.to_owned(),
            node: None,
            prefix: Vec::new(),
            program: Program::Own,
            arguments,
            environment,
            working_directory: None,
            output: Output::Screen,
            respawn: None,
            ends_launch: false,
            is_service: true,
            sigterm_timeout: STOP_TIMEOUT,
            sigkill_timeout: STOP_TIMEOUT,
        },
    })
}

/// The environment of a process.
struct Variables<'a>(&'a Process, &'a dyn Surroundings);

impl Variables<'_> {
    fn get(&self, name: &str) -> Option<String> {
        let mut changes = self.0.environment.iter().rev();
        let value = match changes.find(|(changed, _)| changed == name) {
            Some((_, value)) => value.clone(),
            None => self.1.environment(name),
        };
        value.filter(|value| !value.is_empty())
    }

    fn uses_zenoh(&self) -> bool {
        let words = &self.0.arguments;
        let mut options = words
            .iter()
            .zip(words.iter().skip(1).map(Some).chain([None]));
        let option = options.find_map(|(word, next)| match word.strip_prefix(OPTION)? {
            "" => next.map(String::as_str),
            value => value.strip_prefix('='),
        });
        let (variable, zenoh) = MIDDLEWARE;
        match option {
            Some(middleware) => middleware == "zenoh",
            None => self.get(variable).is_some_and(|value| value == zenoh),
        }
    }
}

/// The pairs of `key=value;key=value`.
fn settings(text: &str) -> impl Iterator<Item = (&str, &str)> {
    let pairs = text.split(';').filter_map(|pair| pair.split_once('='));
    pairs.map(|(key, value)| (key.trim(), value.trim()))
}

/// The address of the first endpoint in a JSON list, if it is on this host's loopback interface.
fn local_address(endpoints: &str) -> Option<String> {
    let endpoints: Vec<String> = serde_json::from_str(endpoints).ok()?;
    let address = endpoints.first()?.strip_prefix("tcp/")?;
    let address = address.split(['?', '#']).next()?;
    let mut resolved = address.to_socket_addrs().ok()?;
    resolved
        .all(|address| address.ip().is_loopback())
        .then(|| address.to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::file::LaunchFile;
    use std::path::Path;

    /// The variables of the launcher.
    struct Environment(Vec<(&'static str, String)>);

    impl Surroundings for Environment {
        fn environment(&self, name: &str) -> Option<String> {
            let mut of_name = self.0.iter().filter(|(known, _)| *known == name);
            of_name.next().map(|(_, value)| value.clone())
        }

        fn read(&self, _path: &Path) -> std::io::Result<String> {
            Err(std::io::ErrorKind::NotFound.into())
        }

        fn exists(&self, _path: &Path) -> bool {
            false
        }
    }

    const ZENOH: (&str, &str) = MIDDLEWARE;
    const ENCODER: &str = "- node: {pkg: wm_nodes, exec: encoder}\n";

    fn needed(entries: &str, variables: &[(&'static str, &str)]) -> Option<Router> {
        let variables = variables.iter();
        let variables = variables.map(|(name, value)| (*name, (*value).to_owned()));
        let environment = Environment(variables.collect());
        let text = format!("launch:\n{entries}");
        let file = LaunchFile::parse(Path::new("t.launch.yaml"), &text).unwrap();
        let plan = Plan::resolve(&file, &BTreeMap::new(), &environment).unwrap();
        needed_router(&plan, &environment)
    }

    #[test]
    fn zenoh_needs_a_router_and_dds_does_not() {
        assert_eq!(needed(ENCODER, &[]), None);
        let dds = [("RMW_IMPLEMENTATION", "rmw_cyclonedds_cpp")];
        assert_eq!(needed(ENCODER, &dds), None);
        let router = needed(ENCODER, &[ZENOH]).unwrap();
        assert_eq!(router.process.arguments, [COMMAND]);
        assert!(
            router
                .addresses
                .iter()
                .all(|address| address.port() == 7447)
        );
        assert!(router.process.is_service);
    }

    #[test]
    fn options_and_variables_of_one_process_count() {
        let with_arguments = |arguments: &str| {
            format!("- node: {{pkg: wm_nodes, exec: encoder, args: \"{arguments}\"}}\n")
        };
        assert!(needed(&with_arguments("--middleware zenoh"), &[]).is_some());
        assert!(needed(&with_arguments("--middleware=zenoh"), &[]).is_some());
        assert_eq!(needed(&with_arguments("--middleware dds"), &[ZENOH]), None);
        let set = "- set_env: {name: RMW_IMPLEMENTATION, value: rmw_zenoh_cpp}\n";
        assert!(needed(&format!("{set}{ENCODER}"), &[]).is_some());
    }

    #[test]
    fn router_gets_the_address_of_the_programs() {
        let settings =
            "connect/endpoints=[\"tcp/127.0.0.1:17447\"];mode=\"client\";queries_default_timeout=5";
        let router = needed(ENCODER, &[ZENOH, (OVERRIDE, settings)]).unwrap();
        let arguments = [COMMAND, "--listen", "tcp/127.0.0.1:17447"];
        assert_eq!(router.process.arguments, arguments);
        let own = "queries_default_timeout=5".to_owned();
        assert_eq!(
            router.process.environment,
            [(OVERRIDE.to_owned(), Some(own))]
        );
    }

    #[test]
    fn own_configuration_or_other_host_gets_no_router() {
        let own = (SESSION_FILE, "/etc/zenoh.json5");
        assert_eq!(needed(ENCODER, &[ZENOH, own]), None);
        let elsewhere = (OVERRIDE, "connect/endpoints=[\"tcp/10.0.0.7:7447\"]");
        assert_eq!(needed(ENCODER, &[ZENOH, elsewhere]), None);
    }

    #[test]
    fn running_router_is_noticed() {
        let listener = std::net::TcpListener::bind("127.0.0.1:0").unwrap();
        let port = listener.local_addr().unwrap().port();
        let settings = format!("connect/endpoints=[\"tcp/127.0.0.1:{port}\"]");
        let router = || needed(ENCODER, &[ZENOH, (OVERRIDE, settings.as_str())]).unwrap();
        assert!(router().is_running());
        drop(listener);
        assert!(!router().is_running());
    }
}
