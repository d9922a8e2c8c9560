//! Parameters: declared by a node with type, description and range; set by the command line and files; changed by the
//! parameter services. An invalid value is always refused, with the parameter's name.

mod declaration;
mod descriptor;
mod remote;
pub(crate) mod services;

pub use declaration::{Field, ParameterSet, ParameterSpec};
pub use descriptor::{Descriptor, Range};
pub use remote::RemoteParameters;

use crate::{
    args::Override,
    value::{Kind, ParameterType, Value},
};
use std::{
    collections::BTreeMap,
    marker::PhantomData,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};

/// Why a parameter cannot have a value.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ParameterError {
    /// It is not declared.
    #[error(
        "{node} has no parameter `{parameter}`{}; it has: {known}",
        from(origin)
    )]
    Undeclared {
        /// The node's full name.
        node: Box<str>,
        /// The parameter.
        parameter: Box<str>,
        /// The source of the value; empty for the services and the program.
        origin: Box<str>,
        /// The declared parameters.
        known: Box<str>,
    },
    /// The value has a different type.
    #[error("{node}: parameter `{parameter}` expects {expected}, got {} {got}{}", got.kind(), from(origin))]
    WrongType {
        /// The node's full name.
        node: Box<str>,
        /// The parameter.
        parameter: Box<str>,
        /// Its type.
        expected: Kind,
        /// The value.
        got: Value,
        /// The source of the value.
        origin: Box<str>,
    },
    /// The value lies outside of the range.
    #[error(
        "{node}: parameter `{parameter}` expects {expected}, got {got}{}",
        from(origin)
    )]
    OutOfRange {
        /// The node's full name.
        node: Box<str>,
        /// The parameter.
        parameter: Box<str>,
        /// Its range.
        expected: Range,
        /// The value.
        got: Value,
        /// The source of the value.
        origin: Box<str>,
    },
    /// The text is not allowed.
    #[error(
        "{node}: parameter `{parameter}` expects {expected}, got {got}{}",
        from(origin)
    )]
    NotAChoice {
        /// The node's full name.
        node: Box<str>,
        /// The parameter.
        parameter: Box<str>,
        /// The allowed texts, as a list.
        expected: Box<str>,
        /// The value.
        got: Value,
        /// The source of the value.
        origin: Box<str>,
    },
    /// It is fixed once the node runs.
    #[error("{node}: parameter `{parameter}` is read-only; set it when you start the node")]
    ReadOnly {
        /// The node's full name.
        node: Box<str>,
        /// The parameter.
        parameter: Box<str>,
    },
    /// It was declared before.
    #[error("{node}: parameter `{parameter}` is declared twice")]
    DeclaredTwice {
        /// The node's full name.
        node: Box<str>,
        /// The parameter.
        parameter: Box<str>,
    },
    /// A check of the node refused the change.
    #[error("{node} refuses the change: {reason}")]
    Refused {
        /// The node's full name.
        node: Box<str>,
        /// The node's reason.
        reason: Box<str>,
    },
}

impl ParameterError {
    /// Whether the cause is a value given at the start of the node.
    pub(crate) fn is_usage(&self) -> bool {
        matches!(
            self,
            Self::Undeclared { .. }
                | Self::WrongType { .. }
                | Self::OutOfRange { .. }
                | Self::NotAChoice { .. }
        )
    }
}

fn from(origin: &str) -> String {
    if origin.is_empty() {
        String::new()
    } else {
        format!(" (from {origin})")
    }
}

/// Checks a change before it is made, and may refuse it.
type Check = Box<dyn Fn(&[(String, Value)]) -> Result<(), String> + Send + Sync>;
/// Receives each change after it is made.
type Observer = Box<dyn Fn(&Change) + Send + Sync>;

/// A completed change.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Change {
    pub(crate) values: Vec<(String, Value)>,
    /// Whether the parameters are new, as opposed to changed.
    pub(crate) is_declaration: bool,
}

#[derive(Debug)]
struct Entry {
    value: Value,
    descriptor: Descriptor,
}

/// The parameters of one node.
pub(crate) struct Parameters {
    node: Box<str>,
    /// The values from files and the command line; the last one for a name applies.
    overrides: Vec<Override>,
    entries: Mutex<BTreeMap<String, Entry>>,
    checks: Mutex<Vec<Check>>,
    observers: Mutex<Vec<Observer>>,
    /// Serialises changes from check to observers, so that both get them in the same order.
    changing: Mutex<()>,
}

/// A panic under a lock leaves only complete entries.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Parameters {
    pub(crate) fn new(node: &str, overrides: &[Override]) -> Self {
        Self {
            node: node.into(),
            overrides: overrides
                .iter()
                .filter(|given| given.section.matches(node))
                .cloned()
                .collect(),
            entries: Mutex::default(),
            checks: Mutex::default(),
            observers: Mutex::default(),
            changing: Mutex::default(),
        }
    }

    fn given(&self, name: &str) -> Option<&Override> {
        self.overrides.iter().rfind(|given| given.name == name)
    }

    /// Values given for names that begin with `prefix`, declared or not.
    pub(crate) fn given_under<'a>(
        &'a self,
        prefix: &'a str,
    ) -> impl Iterator<Item = (&'a str, &'a Value)> {
        self.overrides
            .iter()
            .filter_map(move |given| Some((given.name.strip_prefix(prefix)?, &given.value)))
    }

    /// Declares a parameter: its value is the given one, or the default.
    pub(crate) fn declare(
        &self,
        name: &str,
        default: Value,
        descriptor: Descriptor,
    ) -> Result<Value, ParameterError> {
        let changing = lock(&self.changing);
        let (value, origin) = match self.given(name) {
            Some(given) => (given.value.clone(), given.origin.as_str()),
            None => (default.clone(), "the node's default"),
        };
        let value = self.fit(name, value, default.kind(), &descriptor, origin)?;
        {
            let mut entries = lock(&self.entries);
            if entries.contains_key(name) {
                return Err(ParameterError::DeclaredTwice {
                    node: self.node.clone(),
                    parameter: name.into(),
                });
            }
            entries.insert(
                name.to_owned(),
                Entry {
                    value: value.clone(),
                    descriptor,
                },
            );
        }
        self.tell(&Change {
            values: vec![(name.to_owned(), value.clone())],
            is_declaration: true,
        });
        drop(changing);
        Ok(value)
    }

    /// Checks the values given for undeclared parameters: the first is an error. Values that several nodes may share
    /// are returned, for a warning. Endpoints declare their QoS overrides: with `has_endpoints` only these are checked,
    /// without it only the others.
    pub(crate) fn check_all_declared(
        &self,
        has_endpoints: bool,
    ) -> Result<Vec<Override>, ParameterError> {
        let entries = lock(&self.entries);
        let mut ignored = Vec::new();
        for given in &self.overrides {
            if entries.contains_key(&given.name) || is_qos_override(&given.name) != has_endpoints {
                continue;
            }
            if !given.is_shared {
                return Err(self.undeclared(&entries, &given.name, &given.origin));
            }
            ignored.push(given.clone());
        }
        Ok(ignored)
    }

    fn undeclared(
        &self,
        entries: &BTreeMap<String, Entry>,
        name: &str,
        origin: &str,
    ) -> ParameterError {
        ParameterError::Undeclared {
            node: self.node.clone(),
            parameter: name.into(),
            origin: origin.into(),
            known: entries
                .keys()
                .map(String::as_str)
                .collect::<Vec<_>>()
                .join(", ")
                .into(),
        }
    }

    /// Changes parameters, all of them or none.
    pub(crate) fn set(&self, values: Vec<(String, Value)>) -> Result<(), ParameterError> {
        let changing = lock(&self.changing);
        let values = {
            let entries = lock(&self.entries);
            let fit = |(name, value): (String, Value)| {
                let Some(entry) = entries.get(&name) else {
                    return Err(self.undeclared(&entries, &name, ""));
                };
                if entry.descriptor.read_only {
                    return Err(ParameterError::ReadOnly {
                        node: self.node.clone(),
                        parameter: name.into(),
                    });
                }
                let value = self.fit(&name, value, entry.value.kind(), &entry.descriptor, "")?;
                Ok((name, value))
            };
            values.into_iter().map(fit).collect::<Result<Vec<_>, _>>()?
        };
        for check in lock(&self.checks).iter() {
            check(&values).map_err(|reason| ParameterError::Refused {
                node: self.node.clone(),
                reason: reason.into(),
            })?;
        }
        {
            let mut entries = lock(&self.entries);
            for (name, value) in &values {
                if let Some(entry) = entries.get_mut(name) {
                    entry.value = value.clone();
                }
            }
        }
        self.tell(&Change {
            values,
            is_declaration: false,
        });
        drop(changing);
        Ok(())
    }

    /// The value in the parameter's type and range.
    fn fit(
        &self,
        name: &str,
        value: Value,
        expected: Kind,
        descriptor: &Descriptor,
        origin: &str,
    ) -> Result<Value, ParameterError> {
        let (node, parameter, origin) = (self.node.clone(), name.into(), origin.into());
        let value = match value.coerced(expected) {
            Ok(value) => value,
            Err(got) => {
                return Err(ParameterError::WrongType {
                    node,
                    parameter,
                    expected,
                    got,
                    origin,
                });
            }
        };
        match &descriptor.range {
            Some(range) if !range.contains(&value) => Err(ParameterError::OutOfRange {
                node,
                parameter,
                expected: range.clone(),
                got: value,
                origin,
            }),
            _ if !descriptor.offers(&value) => Err(ParameterError::NotAChoice {
                node,
                parameter,
                expected: descriptor.choices_in_words().into(),
                got: value,
                origin,
            }),
            _ => Ok(value),
        }
    }

    fn tell(&self, change: &Change) {
        for observer in lock(&self.observers).iter() {
            observer(change);
        }
    }

    pub(crate) fn get(&self, name: &str) -> Option<Value> {
        lock(&self.entries)
            .get(name)
            .map(|entry| entry.value.clone())
    }

    pub(crate) fn get_typed<T: ParameterType>(&self, name: &str) -> Result<T, ParameterError> {
        let entries = lock(&self.entries);
        let Some(entry) = entries.get(name) else {
            return Err(self.undeclared(&entries, name, "the program"));
        };
        T::from_value(&entry.value).ok_or_else(|| ParameterError::WrongType {
            node: self.node.clone(),
            parameter: name.into(),
            expected: T::KIND,
            got: entry.value.clone(),
            origin: "the program".into(),
        })
    }

    pub(crate) fn descriptor(&self, name: &str) -> Option<(Kind, Descriptor)> {
        lock(&self.entries)
            .get(name)
            .map(|entry| (entry.value.kind(), entry.descriptor.clone()))
    }

    pub(crate) fn names(&self) -> Vec<String> {
        lock(&self.entries).keys().cloned().collect()
    }

    pub(crate) fn add_check(&self, check: Check) {
        lock(&self.checks).push(check);
    }

    pub(crate) fn add_observer(&self, observer: Observer) {
        lock(&self.observers).push(observer);
    }
}

/// A declared parameter; [`get`](Self::get) returns its current value.
#[derive(Clone)]
pub struct Parameter<T> {
    name: String,
    /// The value at the declaration, a fallback that is never used: entries are not removed.
    declared: T,
    parameters: Arc<Parameters>,
    of: PhantomData<T>,
}

impl<T: ParameterType> Parameter<T> {
    pub(crate) fn new(name: &str, value: &Value, default: T, parameters: Arc<Parameters>) -> Self {
        Self {
            name: name.to_owned(),
            declared: T::from_value(value).unwrap_or(default),
            parameters,
            of: PhantomData,
        }
    }

    /// The parameter's name.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The current value.
    pub fn get(&self) -> T {
        self.parameters
            .get_typed(&self.name)
            .unwrap_or_else(|_| self.declared.clone())
    }
}

/// Whether a name is that of a QoS override, `qos_overrides.<topic>.<publisher|subscription>.<policy>`; its endpoint
/// reads it.
fn is_qos_override(name: &str) -> bool {
    let Some((rest, policy)) = name
        .strip_prefix("qos_overrides.")
        .and_then(|rest| rest.rsplit_once('.'))
    else {
        return false;
    };
    let endpoint = rest.rsplit_once('.');
    endpoint.is_some_and(|(topic, endpoint)| {
        topic.starts_with('/')
            && matches!(endpoint, "publisher" | "subscription")
            && matches!(policy, "reliability" | "durability" | "history" | "depth")
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::NodeArgs;
    use std::sync::atomic::{AtomicUsize, Ordering};

    fn parameters(line: &str) -> Parameters {
        Parameters::new(
            "/wm/encoder",
            &NodeArgs::parse(line.split_whitespace()).unwrap().overrides,
        )
    }

    fn rate() -> Descriptor {
        Descriptor::new("frames a second").floats(0.1, 100.0)
    }

    #[test]
    fn the_last_value_given_holds_and_integers_become_doubles() {
        let parameters = parameters("--ros-args -p rate:=3.5 -p rate:=2 -p decoder:rate:=9");
        assert_eq!(
            parameters.declare("rate", Value::Double(5.0), rate()),
            Ok(Value::Double(2.0))
        );
        assert_eq!(parameters.check_all_declared(false), Ok(vec![]));
    }

    #[test]
    fn errors_name_node_parameter_expected_and_got() {
        let message = |line: &str| {
            parameters(line)
                .declare("rate", Value::Double(5.0), rate())
                .unwrap_err()
                .to_string()
        };
        assert_eq!(
            message("--ros-args -p rate:=fast"),
            "/wm/encoder: parameter `rate` expects double, got string \"fast\" (from -p rate:=fast)"
        );
        assert_eq!(
            message("--ros-args -p rate:=1000"),
            "/wm/encoder: parameter `rate` expects a double from 0.1 to 100.0, got 1000.0 (from -p rate:=1000)"
        );
        let undeclared = parameters("--ros-args -p rat:=1");
        undeclared
            .declare("rate", Value::Double(5.0), rate())
            .unwrap();
        assert_eq!(
            undeclared
                .check_all_declared(false)
                .unwrap_err()
                .to_string(),
            "/wm/encoder has no parameter `rat` (from -p rat:=1); it has: rate"
        );
    }

    #[test]
    fn a_change_is_made_whole_or_not_at_all() {
        let parameters = parameters("");
        parameters
            .declare("rate", Value::Double(5.0), rate())
            .unwrap();
        parameters
            .declare(
                "name",
                Value::String("a".into()),
                Descriptor::new("").read_only(),
            )
            .unwrap();
        let both = vec![
            ("rate".to_owned(), Value::Double(6.0)),
            ("name".to_owned(), Value::String("b".into())),
        ];
        assert!(matches!(
            parameters.set(both),
            Err(ParameterError::ReadOnly { .. })
        ));
        assert_eq!(parameters.get("rate"), Some(Value::Double(5.0)));
        assert!(
            parameters
                .declare("rate", Value::Double(5.0), rate())
                .is_err()
        );
    }

    #[test]
    fn a_check_may_refuse_and_observers_hear_what_is_made() {
        let parameters = parameters("");
        let heard = Arc::new(AtomicUsize::new(0));
        parameters.add_observer(Box::new({
            let heard = Arc::clone(&heard);
            move |_| {
                heard.fetch_add(1, Ordering::Relaxed);
            }
        }));
        parameters
            .declare("rate", Value::Double(5.0), rate())
            .unwrap();
        parameters.add_check(Box::new(|values| match values {
            [(_, Value::Double(value))] if *value == 7.0 => Err("7 is taken".to_owned()),
            _ => Ok(()),
        }));
        let refused = parameters
            .set(vec![("rate".to_owned(), Value::Integer(7))])
            .unwrap_err();
        assert_eq!(
            refused.to_string(),
            "/wm/encoder refuses the change: 7 is taken"
        );
        parameters
            .set(vec![("rate".to_owned(), Value::Integer(8))])
            .unwrap();
        assert_eq!(
            heard.load(Ordering::Relaxed),
            2,
            "the declaration and one change"
        );
    }
}
