//! Zenoh's access control of the router: which certificate may send and receive which key.
//!
//! The keys are rmw_zenoh's (`docs/design.md` of <https://github.com/ros2/rmw_zenoh>): a topic or service is
//! `<domain>/<name>/<type>/<type hash>`. Latched topics also use `<key>/@adv/...`, and each endpoint announces itself by
//! the token `@ros2_lv/<domain>/<session>/<node id>/<id>/<kind>/<enclave>/<namespace>/<node>/<name>/<type>/<hash>/<QoS>`,
//! in which `%` stands for `/`. A wildcard never matches a part that begins with `@`.
//!
//! The flows are the router's: ingress from the session, egress to it. The structure is that of ROS 2's
//! `zenoh_security_tools`, which puts such rules into each session's own file instead.

use super::identity::Identity;
use anyhow::{Result, anyhow};
use serde_json::{Value, json};
use wm_ros::Role;
use zenoh::key_expr::OwnedKeyExpr;

/// Messages in both directions, for the samples, calls or answers of a role, and for the history of latched topics.
struct RoleRules {
    role: Role,
    /// The kind in an endpoint's token.
    kind: &'static str,
    title: &'static str,
    ingress: &'static [&'static str],
    egress: &'static [&'static str],
    /// Of the history, in the same order; empty for services.
    history: [&'static [&'static str]; 2],
}

/// A late subscriber queries the history of a publisher, and looks for such publishers.
const HISTORY_OF_PUBLISHER: [&[&str]; 2] = [
    &["put", "declare_queryable", "reply", "liveliness_token"],
    &[
        "declare_subscriber",
        "query",
        "liveliness_query",
        "declare_liveliness_subscriber",
    ],
];
const HISTORY_OF_SUBSCRIBER: [&[&str]; 2] = [
    &[
        "declare_subscriber",
        "query",
        "liveliness_query",
        "declare_liveliness_subscriber",
        "liveliness_token",
    ],
    &["put", "declare_queryable", "reply", "liveliness_token"],
];

const ROLES: [RoleRules; 4] = [
    RoleRules {
        role: Role::Publisher,
        kind: "MP",
        title: "publishes",
        // answers from the history have the key of the sample
        ingress: &["put", "reply"],
        egress: &["declare_subscriber"],
        history: HISTORY_OF_PUBLISHER,
    },
    RoleRules {
        role: Role::Subscription,
        kind: "MS",
        title: "subscribes",
        ingress: &["declare_subscriber"],
        egress: &["put", "reply"],
        history: HISTORY_OF_SUBSCRIBER,
    },
    RoleRules {
        role: Role::Server,
        kind: "SS",
        title: "serves",
        ingress: &["declare_queryable", "reply"],
        egress: &["query"],
        history: [&[], &[]],
    },
    RoleRules {
        role: Role::Client,
        kind: "SC",
        title: "calls",
        ingress: &["query"],
        egress: &["declare_queryable", "reply"],
        history: [&[], &[]],
    },
];

/// The section `access_control` of the router.
///
/// # Errors
/// A name that is not valid in a key.
pub(super) fn control(domain: u16, identities: &[Identity]) -> Result<Value> {
    let graph = format!("@ros2_lv/{domain}/**");
    let mut rules = vec![
        rule(
            "all read the graph",
            "ingress",
            &["liveliness_query", "declare_liveliness_subscriber"],
            std::slice::from_ref(&graph),
        ),
        rule(
            "all receive the graph",
            "egress",
            &["liveliness_token", "reply"],
            std::slice::from_ref(&graph),
        ),
    ];
    let mut subjects = Vec::new();
    let mut policies = Vec::new();
    for identity in identities {
        let own = rules_of(domain, identity)?;
        let ids = own.iter().map(|rule| rule["id"].clone());
        let shared = rules.iter().take(2).map(|rule| rule["id"].clone());
        let ids: Vec<Value> = shared.chain(ids).collect();
        let name = &identity.name;
        subjects.push(json!({"id": name, "cert_common_names": [name], "link_protocols": ["quic"]}));
        policies.push(json!({"id": name, "rules": ids, "subjects": [name]}));
        rules.extend(own);
    }
    Ok(json!({
        "enabled": true,
        "default_permission": "deny",
        "rules": rules,
        "subjects": subjects,
        "policies": policies,
    }))
}

fn rules_of(domain: u16, identity: &Identity) -> Result<Vec<Value>> {
    let name = &identity.name;
    let mut rules = Vec::new();
    let mut tokens = Vec::new();
    for owner in owners(identity) {
        tokens.push(canonical(format!("@ros2_lv/{domain}/*/*/*/NN/*/{owner}"))?);
    }
    for role in ROLES {
        let (mut keys, mut history) = (Vec::new(), Vec::new());
        for topic in identity.names(role.role) {
            keys.extend(keys_of(domain, topic, "")?);
            history.extend(keys_of(domain, topic, "/@adv/**")?);
            for owner in owners(identity) {
                let (kind, topic) = (role.kind, mangled(topic));
                // ROS 2 Lyrical appends a part
                let token = format!("@ros2_lv/{domain}/*/*/*/{kind}/*/{owner}/{topic}/*/*/*/**");
                tokens.push(canonical(token)?);
            }
        }
        let [history_in, history_out] = role.history;
        for (flow, messages, keys, what) in [
            ("ingress", role.ingress, &keys, ""),
            ("egress", role.egress, &keys, ""),
            ("ingress", history_in, &history, " history"),
            ("egress", history_out, &history, " history"),
        ] {
            if !keys.is_empty() && !messages.is_empty() {
                let id = format!("{name} {}{what} ({flow})", role.title);
                rules.push(rule(&id, flow, messages, keys));
            }
        }
    }
    let id = format!("{name} announces itself");
    rules.push(rule(&id, "ingress", &["liveliness_token"], &tokens));
    Ok(rules)
}

fn rule(id: &str, flow: &str, messages: &[&str], keys: &[String]) -> Value {
    json!({
        "id": id,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": keys,
    })
}

/// The keys of a topic or service, and those of the messages that ROS 2 Lyrical keeps in host memory.
fn keys_of(domain: u16, name: &str, suffix: &str) -> Result<[String; 2]> {
    let name = name.trim_start_matches('/');
    let key = format!("{domain}/{name}/*/*");
    Ok([
        canonical(format!("{key}{suffix}"))?,
        canonical(format!("{key}/_buf_$*{suffix}"))?,
    ])
}

/// The namespaces and names of the nodes, as in tokens.
fn owners(identity: &Identity) -> Vec<String> {
    match &identity.nodes {
        None => vec!["*/*".to_owned()],
        Some(nodes) => nodes.iter().map(|node| owner(node)).collect(),
    }
}

fn owner(node: &str) -> String {
    let (namespace, base) = node.rsplit_once('/').unwrap_or(("", node));
    match namespace {
        "" => format!("%/{base}"),
        namespace => format!("{}/{base}", namespace.replace('/', "%")),
    }
}

/// A name as one part of a token. A wildcard becomes one within the part.
fn mangled(name: &str) -> String {
    match name {
        "/**" => "*".to_owned(),
        name => name
            .replace('/', "%")
            .replace("**", "*")
            .replace('*', "$*")
            .replace("$$", "$"),
    }
}

/// Zenoh accepts each key in one spelling only: `a/*/**`, never `a/**/*`.
fn canonical(key: String) -> Result<String> {
    let canonical = OwnedKeyExpr::autocanonize(key.clone());
    let canonical = canonical.map_err(|error| anyhow!("the key {key}: {error}"))?;
    Ok(canonical.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;
    use wm_ros::{GraphEndpoint, GraphNode};
    use zenoh::key_expr::KeyExpr;

    const PREDICTED: &str = "7/wm/predicted/wm_msgs::msg::dds_::Prediction_/RIHS01_00";

    fn identity(name: &str, endpoints: &[(Role, &str)]) -> Identity {
        let mut node = GraphNode::new(name).unwrap();
        for (role, name) in endpoints {
            node.add(*role, (*name).to_owned());
        }
        Identity::new(name.to_owned(), vec![node])
    }

    /// Whether the rules of the identity permit the message.
    fn permits(control: &Value, name: &str, flow: &str, message: &str, key: &str) -> bool {
        let key = KeyExpr::try_from(key).unwrap();
        let list = |value: &Value| -> Vec<String> {
            let values = value.as_array().unwrap().iter();
            values
                .map(|value| value.as_str().unwrap().to_owned())
                .collect()
        };
        let policies = control["policies"].as_array().unwrap();
        let own = policies
            .iter()
            .find(|policy| list(&policy["subjects"]) == [name]);
        let own = list(&own.unwrap()["rules"]);
        control["rules"].as_array().unwrap().iter().any(|rule| {
            own.contains(&rule["id"].as_str().unwrap().to_owned())
                && list(&rule["flows"]) == [flow]
                && list(&rule["messages"]).contains(&message.to_owned())
                && list(&rule["key_exprs"])
                    .iter()
                    .any(|rule| KeyExpr::try_from(&**rule).unwrap().includes(&key))
        })
    }

    #[test]
    fn node_may_do_what_it_declares_and_no_more() {
        let predictor = identity("/wm/predictor", &[(Role::Publisher, "/wm/predicted")]);
        let control = control(7, &[predictor]).unwrap();
        let may = |flow, message, key: &str| permits(&control, "/wm/predictor", flow, message, key);
        assert!(may("ingress", "put", PREDICTED));
        assert!(may("egress", "declare_subscriber", PREDICTED));
        assert!(may("ingress", "put", &format!("{PREDICTED}/_buf_cpu")));
        assert!(!may("ingress", "declare_subscriber", PREDICTED));
        assert!(!may("egress", "put", PREDICTED));
        for other in [
            "7/wm/plan/wm_msgs::msg::dds_::Plan_/RIHS01_00",
            "8/wm/predicted/wm_msgs::msg::dds_::Prediction_/RIHS01_00",
            "7/wm/predicted/image/sensor_msgs::msg::dds_::Image_/RIHS01_00",
            "7/**",
            "**",
        ] {
            assert!(!may("ingress", "put", other), "{other}");
            assert!(!may("ingress", "declare_subscriber", other), "{other}");
            assert!(!may("ingress", "query", other), "{other}");
        }
        let service =
            "7/wm/predictor/get_parameters/rcl_interfaces::srv::dds_::GetParameters_/RIHS01_00";
        assert!(may("ingress", "declare_queryable", service) && may("egress", "query", service));
        assert!(!may("ingress", "query", service));
    }

    #[test]
    fn latched_topics_have_their_history() {
        let one = identity("/wm/executor", &[(Role::Publisher, "/wm/executor/status")]);
        let two = identity("/wm/view", &[(Role::Subscription, "/wm/executor/status")]);
        let control = control(0, &[one, two]).unwrap();
        let key = "0/wm/executor/status/wm_msgs::msg::dds_::ExecutorStatus_/RIHS01_00";
        let history = format!("{key}/@adv/pub/1f/2/_");
        for (flow, message, key) in [
            ("ingress", "declare_queryable", &*history),
            ("ingress", "liveliness_token", &history),
            ("ingress", "reply", key),
            ("egress", "query", &format!("{key}/@adv/**")),
        ] {
            assert!(
                permits(&control, "/wm/executor", flow, message, key),
                "{message}"
            );
        }
        for (flow, message, key) in [
            ("ingress", "query", &*format!("{key}/@adv/**")),
            (
                "ingress",
                "declare_liveliness_subscriber",
                &format!("{key}/@adv/pub/**"),
            ),
            ("egress", "liveliness_token", &history),
            ("egress", "reply", key),
        ] {
            assert!(
                permits(&control, "/wm/view", flow, message, key),
                "{message}"
            );
        }
        assert!(!permits(&control, "/wm/view", "ingress", "reply", key));
    }

    #[test]
    fn node_announces_only_itself() {
        let one = identity("/wm/encoder", &[(Role::Publisher, "/wm/latent")]);
        let root = identity("/driver", &[(Role::Publisher, "/camera/image_raw")]);
        let control = control(0, &[one, root]).unwrap();
        let may = |name, key: &str| permits(&control, name, "ingress", "liveliness_token", key);
        let token = |node: &str, topic: &str| {
            format!(
                "@ros2_lv/0/ab12/0/7/MP/%/{node}/{topic}/wm_msgs::msg::dds_::Latent_/RIHS01_00/::,10:,:,:,,"
            )
        };
        assert!(may("/wm/encoder", "@ros2_lv/0/ab12/0/0/NN/%/%wm/encoder"));
        assert!(may("/wm/encoder", &token("%wm/encoder", "%wm%latent")));
        let lyrical = token("%wm/encoder", "%wm%latent") + "/backends:cpu:";
        assert!(may("/wm/encoder", &lyrical));
        assert!(!may("/wm/encoder", "@ros2_lv/0/ab12/0/0/NN/%/%wm/planner"));
        assert!(!may("/wm/encoder", &token("%wm/planner", "%wm%latent")));
        assert!(!may("/wm/encoder", &token("%wm/encoder", "%wm%plan")));
        assert!(may("/driver", "@ros2_lv/0/ab12/0/0/NN/%/%/driver"));
        assert!(may("/driver", &token("%/driver", "%camera%image_raw")));
        for name in ["/driver", "/wm/encoder"] {
            let graph = "@ros2_lv/0/**";
            assert!(permits(
                &control,
                name,
                "ingress",
                "declare_liveliness_subscriber",
                graph
            ));
        }
    }

    #[test]
    fn wildcards_are_spelled_as_zenoh_accepts_them() {
        let tool = Identity {
            name: "desk".to_owned(),
            nodes: None,
            endpoints: BTreeSet::from(
                [
                    (Role::Subscription, "/**"),
                    (Role::Client, "/**/get_state"),
                    (Role::Publisher, "/a/*/c"),
                ]
                .map(|(role, name)| GraphEndpoint {
                    role,
                    name: name.to_owned(),
                }),
            ),
            lacks_topics: false,
        };
        let control = control(7, &[tool]).unwrap();
        let may = |flow, message, key: &str| permits(&control, "desk", flow, message, key);
        assert!(may("ingress", "declare_subscriber", PREDICTED));
        assert!(may("ingress", "query", &format!("{PREDICTED}/@adv/**")));
        assert!(may(
            "ingress",
            "query",
            "7/wm/encoder/get_state/lifecycle_msgs::srv::dds_::GetState_/RIHS01_00"
        ));
        assert!(!may(
            "ingress",
            "query",
            "7/wm/encoder/change_state/lifecycle_msgs::srv::dds_::ChangeState_/RIHS01_00"
        ));
        assert!(may(
            "ingress",
            "put",
            "7/a/b/c/std_msgs::msg::dds_::String_/RIHS01_00"
        ));
        assert!(!may("ingress", "put", PREDICTED));
        let token = "@ros2_lv/7/ab/0/9/SC/%/%/_ros2cli_77/%wm%encoder%get_state/T/H/::,10:,:,:,,";
        assert!(may("ingress", "liveliness_token", token));
        let token = "@ros2_lv/7/ab/0/9/MP/%/%/x/%a%b%c/T/H/::,10:,:,:,,";
        assert!(may("ingress", "liveliness_token", token));
        assert!(!may(
            "ingress",
            "liveliness_token",
            &token.replace("%a%b%c", "%wm%plan")
        ));
    }

    /// Zenoh itself reads the rules.
    #[test]
    fn zenoh_accepts_the_rules() {
        let predictor = identity("/wm/predictor", &[(Role::Publisher, "/wm/predicted")]);
        let control = control(7, &[predictor]).unwrap();
        let mut config = zenoh::Config::default();
        config
            .insert_json5("access_control", &control.to_string())
            .unwrap();
    }
}
