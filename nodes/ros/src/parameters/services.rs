//! The six parameter services without the transport: request in, response out.

use super::{Change, Parameters, Range};
use crate::rcl_interfaces::value_of;
use wm_msgs::{
    builtin_interfaces::Time,
    rcl_interfaces::{
        DescribeParametersRequest, DescribeParametersResponse, FloatingPointRange,
        GetParameterTypesRequest, GetParameterTypesResponse, GetParametersRequest,
        GetParametersResponse, IntegerRange, ListParametersRequest, ListParametersResponse,
        ListParametersResult, Parameter, ParameterDescriptor, ParameterEvent, ParameterValue,
        SetParametersAtomicallyRequest, SetParametersAtomicallyResponse, SetParametersRequest,
        SetParametersResponse, SetParametersResult,
    },
};

/// `get_parameters`: the default value, "not set", for unknown names.
pub(crate) fn get(
    parameters: &Parameters,
    request: &GetParametersRequest,
) -> GetParametersResponse {
    let value = |name: &String| {
        parameters
            .get(name)
            .map_or_else(ParameterValue::default, ParameterValue::from)
    };
    GetParametersResponse {
        values: request.names.iter().map(value).collect(),
    }
}

/// `get_parameter_types`: 0 for unknown names.
pub(crate) fn get_types(
    parameters: &Parameters,
    request: &GetParameterTypesRequest,
) -> GetParameterTypesResponse {
    let number = |name: &String| parameters.get(name).map_or(0, |value| value.kind() as u8);
    GetParameterTypesResponse {
        types: request.names.iter().map(number).collect(),
    }
}

/// `describe_parameters`: type 0 for unknown names.
pub(crate) fn describe(
    parameters: &Parameters,
    request: &DescribeParametersRequest,
) -> DescribeParametersResponse {
    let describe = |name: &String| {
        let Some((kind, descriptor)) = parameters.descriptor(name) else {
            return ParameterDescriptor {
                name: name.clone(),
                ..ParameterDescriptor::default()
            };
        };
        let (integer_range, floating_point_range) = match descriptor.range {
            None => (vec![], vec![]),
            Some(Range::Integers { from, to }) => (
                vec![IntegerRange {
                    from_value: from,
                    to_value: to,
                    step: 0,
                }],
                vec![],
            ),
            Some(Range::Doubles { from, to }) => (
                vec![],
                vec![FloatingPointRange {
                    from_value: from,
                    to_value: to,
                    step: 0.0,
                }],
            ),
        };
        let additional_constraints = descriptor.choices_in_words();
        ParameterDescriptor {
            name: name.clone(),
            r#type: kind as u8,
            description: descriptor.description,
            additional_constraints,
            read_only: descriptor.read_only,
            dynamic_typing: false,
            floating_point_range,
            integer_range,
        }
    };
    DescribeParametersResponse {
        descriptors: request.names.iter().map(describe).collect(),
    }
}

/// `set_parameters`: each on its own.
pub(crate) fn set(parameters: &Parameters, request: SetParametersRequest) -> SetParametersResponse {
    let set = |parameter| set_all(parameters, vec![parameter]);
    SetParametersResponse {
        results: request.parameters.into_iter().map(set).collect(),
    }
}

/// `set_parameters_atomically`: all or none.
pub(crate) fn set_atomically(
    parameters: &Parameters,
    request: SetParametersAtomicallyRequest,
) -> SetParametersAtomicallyResponse {
    SetParametersAtomicallyResponse {
        result: set_all(parameters, request.parameters),
    }
}

fn set_all(parameters: &Parameters, changes: Vec<Parameter>) -> SetParametersResult {
    let refused = |reason| SetParametersResult {
        successful: false,
        reason,
    };
    let mut values = Vec::with_capacity(changes.len());
    for Parameter { name, value } in changes {
        match value_of(value) {
            Some(value) => values.push((name, value)),
            None => return refused(format!("parameter `{name}` cannot be unset")),
        }
    }
    match parameters.set(values) {
        Ok(()) => SetParametersResult {
            successful: true,
            reason: String::new(),
        },
        Err(error) => refused(error.to_string()),
    }
}

/// `list_parameters`, as in rclcpp: names under the prefixes, at most `depth` levels below them.
pub(crate) fn list(
    parameters: &Parameters,
    request: &ListParametersRequest,
) -> ListParametersResponse {
    let is_within = |levels: usize| {
        request.depth == ListParametersRequest::DEPTH_RECURSIVE || (levels as u64) < request.depth
    };
    let is_listed = |name: &str| {
        if request.prefixes.is_empty() {
            return is_within(name.matches('.').count());
        }
        request
            .prefixes
            .iter()
            .any(|prefix| match name.strip_prefix(prefix.as_str()) {
                Some("") => true,
                Some(below) => below
                    .strip_prefix('.')
                    .is_some_and(|below| is_within(below.matches('.').count())),
                None => false,
            })
    };
    let names: Vec<_> = parameters
        .names()
        .into_iter()
        .filter(|name| is_listed(name))
        .collect();
    let mut prefixes: Vec<_> = names
        .iter()
        .filter_map(|name| Some(name.rsplit_once('.')?.0.to_owned()))
        .collect();
    prefixes.dedup();
    ListParametersResponse {
        result: ListParametersResult { names, prefixes },
    }
}

/// The event that reports a change.
pub(crate) fn event(node: &str, stamp: Time, change: &Change) -> ParameterEvent {
    let values = change
        .values
        .iter()
        .map(|(name, value)| Parameter {
            name: name.clone(),
            value: value.clone().into(),
        })
        .collect();
    let event = ParameterEvent {
        stamp,
        node: node.to_owned(),
        ..ParameterEvent::default()
    };
    if change.is_declaration {
        ParameterEvent {
            new_parameters: values,
            ..event
        }
    } else {
        ParameterEvent {
            changed_parameters: values,
            ..event
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{Descriptor, value::Value};

    fn parameters() -> Parameters {
        let parameters = Parameters::new("/wm/encoder", &[]);
        let declare =
            |name, value, descriptor| parameters.declare(name, value, descriptor).unwrap();
        declare(
            "rate",
            Value::Double(5.0),
            Descriptor::new("frames a second").floats(0.0, 9.0),
        );
        declare(
            "model.path",
            Value::String(String::new()),
            Descriptor::new("").read_only(),
        );
        declare(
            "model.layers.count",
            Value::Integer(4),
            Descriptor::new("").integers(1, 8),
        );
        parameters
    }

    fn names(names: &[&str]) -> Vec<String> {
        names.iter().map(|name| (*name).to_owned()).collect()
    }

    #[test]
    fn unknown_names_are_not_set() {
        let request = GetParameterTypesRequest {
            names: names(&["rate", "rat"]),
        };
        assert_eq!(get_types(&parameters(), &request).types, [3, 0]);
        let request = GetParametersRequest {
            names: names(&["rat"]),
        };
        assert_eq!(
            get(&parameters(), &request).values,
            [ParameterValue::default()]
        );
    }

    #[test]
    fn descriptions_carry_range_and_read_only() {
        let request = DescribeParametersRequest {
            names: names(&["rate", "model.path"]),
        };
        let described = describe(&parameters(), &request).descriptors;
        let [rate, path] = &described[..] else {
            panic!("two answers")
        };
        assert_eq!(rate.description, "frames a second");
        assert_eq!(
            rate.floating_point_range
                .first()
                .map(|range| range.to_value),
            Some(9.0)
        );
        assert!(path.read_only && !rate.read_only);
    }

    #[test]
    fn lists_have_the_requested_depth() {
        let listed = |prefixes: &[&str], depth| {
            let prefixes = names(prefixes);
            let request = ListParametersRequest { prefixes, depth };
            list(&parameters(), &request).result.names
        };
        assert_eq!(listed(&[], 0), ["model.layers.count", "model.path", "rate"]);
        assert_eq!(listed(&[], 1), ["rate"]);
        assert_eq!(listed(&["model"], 1), ["model.path"]);
        assert_eq!(listed(&["model"], 0), ["model.layers.count", "model.path"]);
    }

    #[test]
    fn each_is_set_on_its_own_or_all_together() {
        let rates = [1.0, 99.0].map(|rate| Parameter {
            name: "rate".into(),
            value: Value::Double(rate).into(),
        });
        let parameters = parameters();
        let request = SetParametersAtomicallyRequest {
            parameters: rates.to_vec(),
        };
        assert!(!set_atomically(&parameters, request).result.successful);
        assert_eq!(parameters.get("rate"), Some(Value::Double(5.0)));
        let request = SetParametersRequest {
            parameters: rates.to_vec(),
        };
        let results = set(&parameters, request).results;
        assert_eq!(
            results
                .iter()
                .map(|result| result.successful)
                .collect::<Vec<_>>(),
            [true, false]
        );
        assert!(results.last().unwrap().reason.contains("from 0.0 to 9.0"));
        assert_eq!(parameters.get("rate"), Some(Value::Double(1.0)));
    }
}
