//! The network interfaces that a process uses: the ROS 2 environment variables, and `--interface`.
//!
//! **Loopback is the default.** A participant on several interfaces receives each fragment of a local peer once per
//! interface, which stalls rustdds' reliable readers. The middleware also trusts the lengths in datagrams: six
//! datagrams of a stranger can make it allocate gigabytes. A robot's network is therefore an explicit choice:
//! `--interface eth0`, or `ROS_AUTOMATIC_DISCOVERY_RANGE=SUBNET`. The middleware still binds its sockets to every
//! address; a socket filter drops datagrams for other addresses (module `dds::workarounds::socket_filter`). On an
//! untrusted network, add a firewall and limit the process's memory: `launch-configs/network/` has both.
//!
//! **Unsupported variables** cause an error or a warning with the variable's name. Peers without multicast
//! (`ROS_STATIC_PEERS`) get no announcements. DDS security is not built in. If security is
//! requested and enforced, a node starts only with Zenoh and a session that uses TLS on both sides.

use crate::{Error, Middleware, NodeArgs};
use std::net::{IpAddr, Ipv4Addr};

/// The highest domain for which RTPS' port formula stays below 65536 with room for participants.
const MAX_DOMAIN: u16 = 232;

/// The range of discovery.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Reach {
    /// This host only: 127.0.0.1.
    Localhost,
    /// These addresses of this host.
    Interfaces(Vec<IpAddr>),
    /// Every interface.
    Subnet,
    /// No interface: only nodes of the same process find each other.
    Process,
}

/// The domain and the range of discovery.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Environment {
    /// `ROS_DOMAIN_ID`, 0 to 232.
    pub domain_id: u16,
    /// From `--interface`, otherwise from `ROS_LOCALHOST_ONLY=1`, otherwise from `ROS_AUTOMATIC_DISCOVERY_RANGE`. With
    /// Zenoh, only [`Reach::Process`] has an effect: the router decides.
    pub reach: Reach,
    /// From `--middleware`, otherwise from `RMW_IMPLEMENTATION`.
    pub middleware: Middleware,
}

impl Environment {
    /// From the process's environment variables and the command line.
    ///
    /// # Errors
    /// An invalid variable or interface.
    pub fn from_env(args: &NodeArgs) -> Result<Self, Error> {
        let environment = Self::from_variables(args, variable)?;
        for warning in warnings(&variable, environment.middleware)? {
            tracing::warn!("{warning}");
        }
        Ok(environment)
    }

    fn from_variables(
        args: &NodeArgs,
        variable: impl Fn(&str) -> Option<String>,
    ) -> Result<Self, Error> {
        let domain_id = match variable("ROS_DOMAIN_ID") {
            None => 0,
            Some(text) => match text.parse() {
                Ok(id) if id <= MAX_DOMAIN => id,
                _ => {
                    return Err(invalid(
                        "ROS_DOMAIN_ID",
                        &text,
                        format!("a number from 0 to {MAX_DOMAIN}"),
                    ));
                }
            },
        };
        let implementation = variable("RMW_IMPLEMENTATION").unwrap_or_default(); // unset: the default
        let middleware = match args.middleware {
            Some(middleware) => middleware,
            // `warnings` names an unknown one
            None => Middleware::of_rmw(&implementation).unwrap_or_default(),
        };
        let middleware = middleware.available()?;
        if let (Middleware::Zenoh, Some(interface)) = (middleware, &args.interface) {
            return Err(invalid(
                "--interface",
                interface,
                "DDS as the middleware: with Zenoh, the router and ZENOH_CONFIG_OVERRIDE decide"
                    .to_owned(),
            ));
        }
        let reach = match &args.interface {
            Some(interface) => Reach::Interfaces(vec![address_of(interface)?]),
            None => reach_of(&variable)?,
        };
        Ok(Self {
            domain_id,
            reach,
            middleware,
        })
    }

    /// Environment variables that this runtime cannot obey; nodes run all the same.
    ///
    /// # Errors
    /// An invalid variable, or security that is requested and enforced.
    pub fn warnings() -> Result<Vec<EnvironmentWarning>, Error> {
        warnings(&variable, Middleware::from_env()?)
    }

    /// Whether there are no other participants.
    pub(crate) fn is_alone(&self) -> bool {
        self.reach == Reach::Process
    }

    /// Whether all others are on this host's loopback interface.
    pub(crate) fn is_on_loopback(&self) -> bool {
        let addresses = self.addresses();
        addresses.is_some_and(|addresses| addresses.iter().all(IpAddr::is_loopback))
    }

    /// The addresses whose interfaces are used; `None` for every interface.
    pub(crate) fn addresses(&self) -> Option<Vec<IpAddr>> {
        match &self.reach {
            Reach::Localhost => Some(vec![IpAddr::V4(Ipv4Addr::LOCALHOST)]),
            Reach::Interfaces(addresses) => Some(addresses.clone()),
            Reach::Subnet => None,
            Reach::Process => Some(Vec::new()),
        }
    }
}

/// A variable that has a value.
fn variable(name: &str) -> Option<String> {
    std::env::var(name).ok().filter(|value| !value.is_empty())
}

fn reach_of(variable: &impl Fn(&str) -> Option<String>) -> Result<Reach, Error> {
    // As in ROS 2: ROS_LOCALHOST_ONLY=1 overrules the newer variable.
    match variable("ROS_LOCALHOST_ONLY").as_deref() {
        None | Some("0") => {}
        Some("1") => return Ok(Reach::Localhost),
        Some(text) => return Err(invalid("ROS_LOCALHOST_ONLY", text, "0 or 1".to_owned())),
    }
    // In either case, as rmw_dds_common reads it.
    let range = variable("ROS_AUTOMATIC_DISCOVERY_RANGE").map(|text| text.to_ascii_uppercase());
    match range.as_deref() {
        None | Some("LOCALHOST" | "SYSTEM_DEFAULT") => Ok(Reach::Localhost),
        Some("SUBNET") => Ok(Reach::Subnet),
        Some("OFF") => Ok(Reach::Process),
        Some(text) => Err(invalid(
            "ROS_AUTOMATIC_DISCOVERY_RANGE",
            text,
            "LOCALHOST, SUBNET, OFF or SYSTEM_DEFAULT".to_owned(),
        )),
    }
}

/// An environment variable that this runtime cannot obey.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EnvironmentWarning {
    /// The variable, its value, and the consequence.
    pub problem: String,
    /// The remedy.
    pub fix: String,
}

impl std::fmt::Display for EnvironmentWarning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}; {}", self.problem, self.fix)
    }
}

fn warnings(
    variable: &impl Fn(&str) -> Option<String>,
    middleware: Middleware,
) -> Result<Vec<EnvironmentWarning>, Error> {
    let mut warnings = Vec::new();
    if let Some(middleware) = variable("RMW_IMPLEMENTATION")
        && Middleware::of_rmw(&middleware).is_none()
    {
        warnings.push(EnvironmentWarning {
            problem: format!(
                "RMW_IMPLEMENTATION is `{middleware}`, which this node does not know: it uses DDS, and does not discover \
                 nodes that use `{middleware}`"
            ),
            fix: "set RMW_IMPLEMENTATION=rmw_fastrtps_cpp, rmw_cyclonedds_cpp or rmw_zenoh_cpp for all nodes of the \
                  graph, and unset it if this is so already"
                .to_owned(),
        });
    }
    if let Some(peers) = variable("ROS_STATIC_PEERS") {
        warnings.push(EnvironmentWarning {
            problem: format!(
                "ROS_STATIC_PEERS is `{peers}`, but this middleware announces itself by multicast only: it discovers \
                 these peers only if multicast reaches them"
            ),
            fix: "use a network with multicast, or the Zenoh bridge (`wm-bridge`)".to_owned(),
        });
    }
    let is_wanted = match variable("ROS_SECURITY_ENABLE").as_deref() {
        None | Some("false") => false,
        Some("true") => true,
        // rcl reads any other text as false: a node meant to be secure would not be
        Some(text) => {
            return Err(invalid(
                "ROS_SECURITY_ENABLE",
                text,
                "true or false".to_owned(),
            ));
        }
    };
    if is_wanted {
        let is_enforced = match variable("ROS_SECURITY_STRATEGY").as_deref() {
            Some("Enforce") => true,
            None | Some("Permissive") => false,
            Some(text) => {
                return Err(invalid(
                    "ROS_SECURITY_STRATEGY",
                    text,
                    "Enforce or Permissive".to_owned(),
                ));
            }
        };
        match secured(middleware) {
            Ok(()) => {}
            Err(error) if is_enforced => return Err(error),
            Err(_) => warnings.push(insecure(middleware)),
        }
    }
    Ok(warnings)
}

/// Whether all communication is authenticated and encrypted.
///
/// # Errors
/// It is not.
fn secured(middleware: Middleware) -> Result<(), Error> {
    match middleware {
        Middleware::Dds => Err(Error::NoSecurity),
        #[cfg(feature = "zenoh")]
        Middleware::Zenoh => crate::secured_session::check(&crate::zenoh::session_config()?),
        #[cfg(not(feature = "zenoh"))]
        Middleware::Zenoh => Err(Error::NoZenoh),
    }
}

/// Security is requested, but not enforced.
fn insecure(middleware: Middleware) -> EnvironmentWarning {
    let (cause, fix) = match middleware {
        Middleware::Dds => (
            "DDS security is not built in",
            "set ROS_SECURITY_STRATEGY=Enforce if it must not start then, or unset ROS_SECURITY_ENABLE",
        ),
        Middleware::Zenoh => (
            "the Zenoh session permits connections without TLS on both sides",
            "set ZENOH_SESSION_CONFIG_URI to a file of `wm keys`, or unset ROS_SECURITY_ENABLE",
        ),
    };
    EnvironmentWarning {
        problem: format!(
            "ROS_SECURITY_ENABLE is `true`, but {cause}: this node's communication is neither encrypted nor \
             authenticated"
        ),
        fix: fix.to_owned(),
    }
}

/// An address of this host, and the interface that has it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Interface {
    /// As `--interface` takes it: `eth0`.
    pub name: String,
    /// An IPv4 address: the middleware supports no other.
    pub address: IpAddr,
}

impl Interface {
    /// Those of this host.
    ///
    /// # Errors
    /// The system cannot list them.
    pub fn all() -> Result<Vec<Self>, Error> {
        let interfaces = if_addrs::get_if_addrs()
            .map_err(|source| Error::io("list the network interfaces", source))?;
        let usable = interfaces.into_iter().filter(|found| found.ip().is_ipv4());
        let known = usable.map(|found| Self {
            address: found.ip(),
            name: found.name,
        });
        Ok(known.collect())
    }
}

fn address_of(interface: &str) -> Result<IpAddr, Error> {
    let interfaces = Interface::all()?;
    let wanted = interface.parse::<IpAddr>().ok();
    match interfaces
        .iter()
        .find(|candidate| candidate.name == interface || wanted == Some(candidate.address))
    {
        Some(found) => Ok(found.address),
        None => {
            let known: Vec<_> = interfaces
                .iter()
                .map(|candidate| format!("{} ({})", candidate.name, candidate.address))
                .collect();
            Err(invalid(
                "--interface",
                interface,
                format!("one of {}", known.join(", ")),
            ))
        }
    }
}

fn invalid(variable: &'static str, value: &str, expected: String) -> Error {
    Error::Environment {
        variable,
        value: value.to_owned(),
        expected,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn environment(line: &str, variables: &[(&str, &str)]) -> Result<Environment, Error> {
        let args = NodeArgs::parse(line.split_whitespace())?;
        Environment::from_variables(&args, |name| {
            variables
                .iter()
                .find(|(key, _)| *key == name)
                .map(|(_, value)| (*value).to_owned())
        })
    }

    #[test]
    fn loopback_unless_asked_otherwise() {
        let reach = |variables: &[(&str, &str)]| environment("", variables).unwrap().reach;
        assert_eq!(reach(&[]), Reach::Localhost);
        assert_eq!(
            reach(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")]),
            Reach::Subnet
        );
        assert_eq!(
            reach(&[
                ("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET"),
                ("ROS_LOCALHOST_ONLY", "1")
            ]),
            Reach::Localhost
        );
        for (range, expected) in [
            ("OFF", Reach::Process),
            ("off", Reach::Process),
            ("LOCALHOST", Reach::Localhost),
            ("SYSTEM_DEFAULT", Reach::Localhost),
        ] {
            assert_eq!(reach(&[("ROS_AUTOMATIC_DISCOVERY_RANGE", range)]), expected);
        }
        let environment = environment(
            "--interface 127.0.0.1",
            &[("ROS_AUTOMATIC_DISCOVERY_RANGE", "SUBNET")],
        )
        .unwrap();
        assert_eq!(
            environment.addresses(),
            Some(vec![IpAddr::V4(Ipv4Addr::LOCALHOST)])
        );
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        let message = |line, variables: &[(&str, &str)]| {
            environment(line, variables).unwrap_err().to_string()
        };
        assert_eq!(
            message("", &[("ROS_DOMAIN_ID", "233")]),
            "ROS_DOMAIN_ID is `233`: expected a number from 0 to 232"
        );
        assert!(message("", &[("ROS_AUTOMATIC_DISCOVERY_RANGE", "WORLD")]).contains("SUBNET"));
        assert!(message("", &[("ROS_LOCALHOST_ONLY", "yes")]).contains("0 or 1"));
        assert!(message("--interface nope0", &[]).contains("one of"));
    }

    #[test]
    fn what_cannot_be_done_is_said_or_refused() {
        let asked = |variables: &[(&str, &str)]| {
            let variable = |name: &str| {
                let found = variables.iter().find(|(key, _)| *key == name);
                found.map(|(_, value)| (*value).to_owned())
            };
            let implementation = variable("RMW_IMPLEMENTATION").unwrap_or_default();
            let middleware = Middleware::of_rmw(&implementation).unwrap_or_default();
            match warnings(&variable, middleware) {
                Ok(warnings) => {
                    let warnings = warnings.iter().map(ToString::to_string);
                    warnings.collect::<Vec<_>>().join("\n")
                }
                Err(error) => format!("refused: {error}"),
            }
        };
        assert_eq!(asked(&[]), "");
        assert_eq!(asked(&[("ROS_SECURITY_ENABLE", "false")]), "");
        assert!(
            asked(&[("ROS_STATIC_PEERS", "10.0.0.7")]).contains("ROS_STATIC_PEERS is `10.0.0.7`")
        );
        for middleware in ["rmw_fastrtps_cpp", "rmw_zenoh_cpp"] {
            assert_eq!(asked(&[("RMW_IMPLEMENTATION", middleware)]), "");
        }
        for middleware in ["rmw_email_cpp", "fastrtps"] {
            let warning = asked(&[("RMW_IMPLEMENTATION", middleware)]);
            let begin =
                format!("RMW_IMPLEMENTATION is `{middleware}`, which this node does not know");
            assert!(warning.starts_with(&begin), "{warning}");
            assert!(warning.contains("set RMW_IMPLEMENTATION="), "{warning}");
        }
        let secure = |strategy| {
            asked(&[
                ("ROS_SECURITY_ENABLE", "true"),
                ("ROS_SECURITY_STRATEGY", strategy),
            ])
        };
        assert!(secure("Permissive").contains("neither encrypted nor"));
        assert!(secure("Enforce").contains("refused: ") && secure("Enforce").contains("Enforce"));
        assert!(secure("enforce").contains("refused: ROS_SECURITY_STRATEGY is `enforce`"));
        assert!(asked(&[("ROS_SECURITY_ENABLE", "True")]).contains("refused: ROS_SECURITY_ENABLE"));
        assert!(secure("Enforce").contains("wm keys"));
        // the default session uses TCP
        #[cfg(feature = "zenoh")]
        for (strategy, expected) in [
            (
                "Enforce",
                "refused: ROS_SECURITY_STRATEGY is `Enforce`, but",
            ),
            ("Permissive", "neither encrypted nor"),
        ] {
            let answer = asked(&[
                ("RMW_IMPLEMENTATION", "rmw_zenoh_cpp"),
                ("ROS_SECURITY_ENABLE", "true"),
                ("ROS_SECURITY_STRATEGY", strategy),
            ]);
            assert!(
                answer.contains(expected) && answer.contains("Zenoh session"),
                "{answer}"
            );
        }
    }
}
