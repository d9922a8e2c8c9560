//! `qos_overrides.<topic>.<publisher|subscription>.<policy>`: QoS from the command line or a parameter file.

use crate::{
    Descriptor, Durability, Error, Qos, Reliability,
    parameters::{ParameterError, Parameters},
    value::Value,
};

/// Applies the overrides for this endpoint to its profile. Each applied one becomes a parameter, read-only as in
/// rclcpp; [`Parameters::check_all_declared`] finds unused ones after all endpoints are made.
pub(super) fn apply(
    parameters: &Parameters,
    node: &str,
    topic: &str,
    endpoint: &str,
    mut qos: Qos,
) -> Result<Qos, Error> {
    let prefix = format!("qos_overrides.{topic}.{endpoint}.");
    for (policy, value) in parameters.given_under(&prefix) {
        let applied = match (policy, value) {
            ("reliability", Value::String(text)) => {
                reliability(text).map(|value| qos.reliability = value)
            }
            ("durability", Value::String(text)) => {
                durability(text).map(|value| qos.durability = value)
            }
            ("depth", Value::Integer(depth)) if *depth > 0 => {
                usize::try_from(*depth).ok().map(|value| qos.depth = value)
            }
            // the only supported history
            ("history", Value::String(text)) if text == "keep_last" => Some(()),
            _ => None,
        };
        if applied.is_none() {
            let reason = format!(
                "`{prefix}{policy}` is {value}: expected reliability (reliable, best_effort), durability (volatile, \
                 transient_local), history (keep_last) or depth (1 and up)"
            );
            return Err(ParameterError::Refused {
                node: node.into(),
                reason: reason.into(),
            }
            .into());
        }
        let name = format!("{prefix}{policy}");
        // It exists already if the node is activated again.
        if parameters.get(&name).is_none() {
            let text = "QoS of the topic's endpoint, given when the node was started";
            parameters.declare(&name, value.clone(), Descriptor::new(text).read_only())?;
        }
    }
    Ok(qos)
}

fn reliability(text: &str) -> Option<Reliability> {
    match text {
        "reliable" => Some(Reliability::Reliable),
        "best_effort" => Some(Reliability::BestEffort),
        _ => None,
    }
}

fn durability(text: &str) -> Option<Durability> {
    match text {
        "volatile" => Some(Durability::Volatile),
        "transient_local" => Some(Durability::TransientLocal),
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeArgs;

    fn applied(line: &str) -> Result<Qos, Error> {
        let args = NodeArgs::parse(line.split_whitespace())?;
        apply(
            &Parameters::new("/wm/a", &args.overrides),
            "/wm/a",
            "/wm/latent",
            "publisher",
            Qos::sensor_data(),
        )
    }

    #[test]
    fn only_the_named_endpoint_and_policy_change() {
        let line = "--ros-args -p qos_overrides./wm/latent.publisher.reliability:=reliable \
                    -p qos_overrides./wm/latent.publisher.depth:=7 -p qos_overrides./wm/other.publisher.depth:=9 \
                    -p qos_overrides./wm/latent.subscription.depth:=3";
        assert_eq!(applied(line).unwrap(), Qos::reliable(7));
        assert_eq!(applied("").unwrap(), Qos::sensor_data());
    }

    #[test]
    fn nonsense_is_refused_by_name() {
        let error = applied("--ros-args -p qos_overrides./wm/latent.publisher.reliability:=maybe")
            .unwrap_err();
        assert!(
            error
                .to_string()
                .contains("qos_overrides./wm/latent.publisher.reliability"),
            "{error}"
        );
        assert!(applied("--ros-args -p qos_overrides./wm/latent.publisher.depth:=0").is_err());
    }

    #[test]
    fn what_no_endpoint_takes_is_refused_once_all_are_made() {
        let line = "--ros-args -p qos_overrides./wm/latent.publisher.depth:=7 \
                    -p qos_overrides./wm/latnet.publisher.depth:=9";
        let args = NodeArgs::parse(line.split_whitespace()).unwrap();
        let parameters = Parameters::new("/wm/a", &args.overrides);
        assert_eq!(parameters.check_all_declared(false), Ok(vec![]), "not yet");
        let apply = || {
            let qos = Qos::sensor_data();
            apply(&parameters, "/wm/a", "/wm/latent", "publisher", qos)
        };
        assert_eq!((apply().unwrap().depth, apply().unwrap().depth), (7, 7));
        let error = parameters.check_all_declared(true).unwrap_err().to_string();
        assert!(
            error.contains("`qos_overrides./wm/latnet.publisher.depth`")
                && error.contains("it has: qos_overrides./wm/latent.publisher.depth"),
            "{error}"
        );
    }
}
