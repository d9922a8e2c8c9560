//! Announcements of a bridge's endpoints as liveliness tokens, in the format of the ros2dds bridge: `@/<zenoh
//! id>/@ros2_lv/MP/<key>/<type>/<qos>` for a publisher, `MS` for a subscriber; `@/<zenoh id>/@ros2_lv/SS/<key>/<type>`
//! for a service's server, `SC` for a client. `§` replaces slashes within a part.
//!
//! The QoS is `<K if the topic has keys>:<reliability>:<durability>:<history>,<depth>`, numbered as in Cyclone DDS and
//! empty for defaults. A fifth part, the type's hash, may follow.

use wm_ros::{Durability, Qos, Reliability};
use zenoh::key_expr::OwnedKeyExpr;

const SLASH: &str = "§";

/// The deepest history that is accepted from others, so that they cannot make the bridge keep more.
pub(crate) const MAX_DEPTH: usize = 100;
/// DDS' default depth, if the announcement has none.
const DEFAULT_DEPTH: usize = 1;

/// The endpoint of an announcement.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) enum Subject {
    /// A publisher, with its offered QoS.
    Publisher(Qos),
    /// A subscriber, with its requested QoS.
    Subscriber(Qos),
    Server,
    Client,
}

/// A topic or service of one side of a bridge.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Announcement {
    /// The bridge's Zenoh id.
    pub bridge: String,
    pub subject: Subject,
    /// Its key on Zenoh, for example `wm/latent`.
    pub key: String,
    /// `package/msg/Type` or `package/srv/Type`.
    pub type_name: String,
}

/// Why a token is not an announcement of a topic or service.
#[derive(Debug, PartialEq, Eq, thiserror::Error)]
#[error("`{token}` announces no topic or service: expected {expected}")]
pub(crate) struct TokenError {
    token: String,
    expected: &'static str,
}

impl Announcement {
    /// The key expression of all announcements.
    pub(crate) const ALL: &str = "@/*/@ros2_lv/**";

    pub(crate) fn token(&self) -> Result<OwnedKeyExpr, zenoh::Error> {
        let escape = |text: &str| text.replace('/', SLASH);
        let (kind, qos) = match &self.subject {
            Subject::Publisher(qos) => ("MP", Some(qos)),
            Subject::Subscriber(qos) => ("MS", Some(qos)),
            Subject::Server => ("SS", None),
            Subject::Client => ("SC", None),
        };
        let qos = qos.map_or_else(String::new, |qos| format!("/{}", qos_part(qos)));
        OwnedKeyExpr::new(format!(
            "@/{}/@ros2_lv/{kind}/{}/{}{qos}",
            self.bridge,
            escape(&self.key),
            escape(&self.type_name)
        ))
    }

    /// Parses a token. Tokens of actions (`AS`, `AC`) are errors.
    ///
    /// # Errors
    /// The token has another form.
    pub(crate) fn parse(token: &str) -> Result<Self, TokenError> {
        let refused = |expected| TokenError {
            token: token.to_owned(),
            expected,
        };
        let parts: Vec<&str> = token.split('/').collect();
        let (bridge, kind, key, type_name, qos) = match parts[..] {
            ["@", bridge, "@ros2_lv", kind, key, type_name] => (bridge, kind, key, type_name, None),
            ["@", bridge, "@ros2_lv", kind, key, type_name, qos] => {
                (bridge, kind, key, type_name, Some(qos))
            }
            _ => return Err(refused("@/ID/@ros2_lv/KIND/KEY/TYPE[/QOS]")),
        };
        let qos = || {
            qos.and_then(parse_qos)
                .ok_or_else(|| refused("a QoS such as :1:0:0,10, for a topic without keys"))
        };
        let subject = match kind {
            "MP" => Subject::Publisher(qos()?),
            "MS" => Subject::Subscriber(qos()?),
            "SS" => Subject::Server,
            "SC" => Subject::Client,
            _ => return Err(refused("the kind MP, MS, SS or SC")),
        };
        let unescape = |text: &str| text.replace(SLASH, "/");
        Ok(Self {
            bridge: bridge.to_owned(),
            subject,
            key: unescape(key),
            type_name: unescape(type_name),
        })
    }
}

fn qos_part(qos: &Qos) -> String {
    let reliability = match qos.reliability {
        Reliability::BestEffort => 0,
        Reliability::Reliable => 1,
    };
    let durability = match qos.durability {
        Durability::Volatile => 0,
        Durability::TransientLocal => 1,
    };
    format!(":{reliability}:{durability}:0,{}", qos.depth)
}

fn parse_qos(text: &str) -> Option<Qos> {
    let mut parts = text.split(':');
    let (keys, reliability, durability, history) =
        (parts.next()?, parts.next()?, parts.next()?, parts.next()?);
    // ROS 2 has no topics with keys
    if !keys.is_empty() {
        return None;
    }
    let depth = match history {
        "" => DEFAULT_DEPTH,
        history => match history.split_once(',')? {
            ("0", depth) => usize::try_from(depth.parse::<i32>().ok()?).ok()?,
            // keep all
            ("1", _) => MAX_DEPTH,
            _ => return None,
        },
    };
    Some(Qos {
        reliability: match reliability {
            "" | "0" => Reliability::BestEffort,
            "1" => Reliability::Reliable,
            _ => return None,
        },
        durability: match durability {
            "" | "0" => Durability::Volatile,
            "1" | "2" | "3" => Durability::TransientLocal,
            _ => return None,
        },
        depth: depth.clamp(1, MAX_DEPTH),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn tokens_match_the_real_bridges() {
        let announcement = Announcement {
            bridge: "a1b2".into(),
            subject: Subject::Publisher(Qos::latched(3)),
            key: "robot1/wm/latent".into(),
            type_name: "wm_msgs/msg/Latent".into(),
        };
        assert_eq!(
            announcement.token().unwrap().as_str(),
            "@/a1b2/@ros2_lv/MP/robot1§wm§latent/wm_msgs§msg§Latent/:1:1:0,3"
        );
        let server = Announcement {
            subject: Subject::Server,
            type_name: "wm_msgs/srv/Reset".into(),
            ..announcement
        };
        assert_eq!(
            server.token().unwrap().as_str(),
            "@/a1b2/@ros2_lv/SS/robot1§wm§latent/wm_msgs§srv§Reset"
        );
    }

    #[test]
    fn tokens_of_the_real_bridge_are_parsed() {
        let qos = |part: &str| {
            let token = format!("@/a1/@ros2_lv/MS/chatter/std_msgs§msg§String/{part}");
            Announcement::parse(&token).map(|announcement| announcement.subject)
        };
        let subscriber = |qos| Ok(Subject::Subscriber(qos));
        assert_eq!(qos(":::"), subscriber(Qos::best_effort(1)));
        assert_eq!(qos(":1::0,10"), subscriber(Qos::reliable(10)));
        assert_eq!(qos(":1:1:1,-1"), subscriber(Qos::latched(MAX_DEPTH)));
        assert_eq!(
            qos(":1:0:0,2147483647:typehash=RIHS01_df66;"),
            subscriber(Qos::reliable(MAX_DEPTH))
        );
        assert!(qos("K:1:0:0,10").is_err());
        assert!(qos(":1:0:0,-4").is_err());
        assert!(Announcement::parse("@/a1/@ros2_lv").is_err());
        assert!(Announcement::parse("@/a1/@ros2_lv/AS/fibonacci/x§action§Y").is_err());
    }

    fn announcements() -> impl Strategy<Value = Announcement> {
        let qos = (any::<bool>(), any::<bool>(), 1..=MAX_DEPTH).prop_map(
            |(is_reliable, is_latched, depth)| Qos {
                reliability: if is_reliable {
                    Reliability::Reliable
                } else {
                    Reliability::BestEffort
                },
                durability: if is_latched {
                    Durability::TransientLocal
                } else {
                    Durability::Volatile
                },
                depth,
            },
        );
        let subject = prop_oneof![
            qos.clone().prop_map(Subject::Publisher),
            qos.prop_map(Subject::Subscriber),
            Just(Subject::Server),
            Just(Subject::Client),
        ];
        let names = (
            "[0-9a-f]{1,32}",
            "[a-z0-9_]{1,6}(/[a-z0-9_]{1,6}){0,3}",
            "[a-z]{1,6}/(msg|srv)/[A-Z][a-z]{0,6}",
        );
        (subject, names).prop_map(|(subject, (bridge, key, type_name))| Announcement {
            bridge,
            subject,
            key,
            type_name,
        })
    }

    proptest! {
        #[test]
        fn an_announcement_survives(announcement in announcements()) {
            let token = announcement.token().unwrap();
            prop_assert_eq!(Announcement::parse(&token), Ok(announcement));
        }

        #[test]
        fn no_token_panics(token in "(@/a/@ros2_lv/(MP|MS|SS|XX)/[a§*]{0,3}/[a§]{0,3}(/[K:0-9,-]{0,12})?)|\\PC{0,40}") {
            let _ = Announcement::parse(&token);
        }
    }
}
