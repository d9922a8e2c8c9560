//! Parameters, each declared once: a table of name, type, default, range and description. The node's struct, `ros2
//! param describe`, `wm NODE --help`, the parameter file and the flags of `wm bag` are made from it.

use super::{Descriptor, Parameter, ParameterError, Range};
use crate::{
    Error, Node,
    value::{ParameterType, Value},
};
use std::{path::PathBuf, time::Duration};

/// The declaration of a parameter, without a node.
#[derive(Clone, Debug, PartialEq)]
pub struct ParameterSpec {
    /// The name.
    pub name: &'static str,
    /// The value if none is given.
    pub default: Value,
    /// Meaning with its unit, allowed values, and whether it is fixed while the node runs.
    pub descriptor: Descriptor,
}

impl ParameterSpec {
    /// A parameter that is read as an `F`.
    pub fn of<F: Field>(name: &'static str, text: &str, default: impl Into<F::Ros>) -> Self {
        let descriptor = Descriptor {
            description: text.trim().to_owned(),
            range: F::limits(),
            choices: F::CHOICES,
            read_only: F::IS_READ_ONLY,
        };
        Self {
            name,
            default: default.into().into_value(),
            descriptor,
        }
    }

    /// Allows values in `range` only.
    #[must_use]
    pub fn range(mut self, range: impl Into<Range>) -> Self {
        self.descriptor.range = Some(range.into());
        self
    }

    /// Allows these texts only.
    #[must_use]
    pub fn choices(mut self, choices: &'static [&'static str]) -> Self {
        self.descriptor.choices = choices;
        self
    }

    /// Declares it on `node` and reads it.
    ///
    /// # Errors
    /// The value given has a different type or is not allowed, or the parameter is declared already.
    pub fn declare<F: Field>(&self, node: &Node) -> Result<F, Error> {
        let refused = |reason: String| ParameterError::Refused {
            node: node.fully_qualified_name().into(),
            reason: reason.into(),
        };
        let default = F::Ros::from_value(&self.default).ok_or_else(|| {
            refused(format!(
                "the default of `{}` is no {}",
                self.name,
                F::Ros::KIND
            ))
        })?;
        let parameter = node.declare(self.name, default, self.descriptor.clone())?;
        let value = self.default.clone();
        F::read(parameter)
            .ok_or_else(|| refused(format!("`{}` cannot be read; {value} could", self.name)).into())
    }

    /// The error for a text that is not a choice. The declaration has refused it already.
    pub fn not_a_choice(&self, node: &Node, got: &str) -> Error {
        let reason = format!("`{}` is \"{got}\"", self.name);
        ParameterError::Refused {
            node: node.fully_qualified_name().into(),
            reason: reason.into(),
        }
        .into()
    }
}

/// A set of parameters, which [`parameters!`](crate::parameters) makes.
pub trait ParameterSet: Sized {
    /// All of them, in the order in which they are documented.
    fn specs() -> Vec<ParameterSpec>;

    /// Declares them on `node` and reads them.
    ///
    /// # Errors
    /// Names the parameter with an invalid value.
    fn declare(node: &Node) -> Result<Self, Error>;
}

/// A Rust type of a parameter's value. A plain one is read once, when the node starts; a [`Parameter`] can be changed
/// while the node runs.
pub trait Field: Sized {
    /// The parameter's type in ROS.
    type Ros: ParameterType;
    /// Whether the value is fixed once the node runs.
    const IS_READ_ONLY: bool = true;
    /// The texts allowed; empty: all values of the type.
    const CHOICES: &'static [&'static str] = &[];

    /// The range of the type, if ROS' type has a larger one.
    fn limits() -> Option<Range> {
        None
    }

    /// The declared value; `None` if the type cannot represent it, which its limits and choices rule out.
    fn read(parameter: Parameter<Self::Ros>) -> Option<Self>;
}

impl<T: ParameterType> Field for Parameter<T> {
    type Ros = T;
    const IS_READ_ONLY: bool = false;

    fn read(parameter: Self) -> Option<Self> {
        Some(parameter)
    }
}

macro_rules! plain_fields {
    ($($type:ty),* $(,)?) => {
        $(impl Field for $type {
            type Ros = $type;

            fn read(parameter: Parameter<$type>) -> Option<Self> {
                Some(parameter.get())
            }
        })*
    };
}

plain_fields!(bool, i64, f64, String, Vec<i64>, Vec<f64>);

/// Without the empty texts: a parameter file cannot hold an empty list, so `['']` stands for it.
impl Field for Vec<String> {
    type Ros = Self;

    fn read(parameter: Parameter<Self>) -> Option<Self> {
        let texts = parameter.get().into_iter();
        Some(texts.filter(|text| !text.is_empty()).collect())
    }
}

macro_rules! integer_fields {
    ($($type:ty),* $(,)?) => {
        $(impl Field for $type {
            type Ros = i64;

            fn limits() -> Option<Range> {
                let from = i64::try_from(<$type>::MIN).unwrap_or(i64::MIN);
                let to = i64::try_from(<$type>::MAX).unwrap_or(i64::MAX);
                Some(Range::Integers { from, to })
            }

            fn read(parameter: Parameter<i64>) -> Option<Self> {
                parameter.get().try_into().ok()
            }
        })*
    };
}

integer_fields!(u8, u16, u32, u64, usize, i32);

/// Seconds.
impl Field for Duration {
    type Ros = f64;

    fn limits() -> Option<Range> {
        // a year of waiting is a mistake in the unit
        Some(Range::from(0.0..=31_536_000.0))
    }

    fn read(parameter: Parameter<f64>) -> Option<Self> {
        Self::try_from_secs_f64(parameter.get()).ok()
    }
}

/// Relative to the working directory.
impl Field for PathBuf {
    type Ros = String;

    fn read(parameter: Parameter<String>) -> Option<Self> {
        Some(parameter.get().into())
    }
}

/// Makes a struct of parameters, and its [`ParameterSet`], from a table: doc comment, field, type and default, then the
/// values allowed. Field types are those of [`Field`]; a field of type [`Parameter`] can be changed while the node runs.
/// With `one_of` the parameter is a text and the field any type.
///
/// ```
/// use wm_ros::{Parameter, ParameterSet as _};
///
/// #[derive(Clone, Copy, Debug, PartialEq)]
/// enum Returned { Best, Mean }
///
/// wm_ros::parameters! {
///     /// The parameters of the search.
///     struct Parameters {
///         /// Candidates per iteration.
///         population: usize = 32, in 2..=1_000_000;
///         /// Time between two plans [s].
///         period: f64 = 2.0, in 0.0..=3600.0;
///         /// Model steps of a plan.
///         horizon: Parameter<i64> = 8, in 1..=64;
///         /// Which actions are returned.
///         returned: Returned = "best_seen", one_of { "best_seen" => Returned::Best, "final_mean" => Returned::Mean };
///         /// Begin again at the end.
///         is_looping as "loop": bool = false;
///     }
/// }
///
/// let names: Vec<_> = Parameters::specs().iter().map(|spec| spec.name).collect();
/// assert_eq!(names, ["population", "period", "horizon", "returned", "loop"]);
/// assert!(!Parameters::specs()[2].descriptor.read_only);
/// ```
#[macro_export]
macro_rules! parameters {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $set:ident {
            $(
                $(#[doc = $text:literal])+
                $field_visibility:vis $field:ident $(as $name:literal)? : $type:ty = $default:expr
                    $(, in $range:expr)?
                    $(, one_of { $($choice:literal => $value:expr),+ $(,)? })?
            );* $(;)?
        }
    ) => {
        $(#[$attribute])*
        #[allow(rustdoc::broken_intra_doc_links, reason = "units in brackets are no links")]
        $visibility struct $set {
            $($(#[doc = $text])+ $field_visibility $field: $type,)*
        }

        impl $crate::ParameterSet for $set {
            fn specs() -> ::std::vec::Vec<$crate::ParameterSpec> {
                ::std::vec![$(
                    $crate::parameters!(
                        @spec $type, $crate::parameters!(@name $field $($name)?), ::std::concat!($($text),+), $default,
                        [$($range)?] [$($($choice)+)?]
                    )
                ),*]
            }

            fn declare(node: &$crate::Node) -> ::std::result::Result<Self, $crate::Error> {
                ::std::result::Result::Ok(Self {
                    $($field: {
                        let spec = $crate::parameters!(
                            @spec $type, $crate::parameters!(@name $field $($name)?), ::std::concat!($($text),+), $default,
                            [$($range)?] [$($($choice)+)?]
                        );
                        $crate::parameters!(@read node, spec, $type, [$($($choice => $value),+)?])
                    },)*
                })
            }
        }
    };
    (@name $field:ident) => { ::std::stringify!($field) };
    (@name $field:ident $name:literal) => { $name };
    (@spec $type:ty, $name:expr, $text:expr, $default:expr, [$($range:expr)?] []) => {
        $crate::ParameterSpec::of::<$type>($name, $text, $default) $(.range($range))?
    };
    (@spec $type:ty, $name:expr, $text:expr, $default:expr, [] [$($choice:literal)+]) => {
        $crate::ParameterSpec::of::<::std::string::String>($name, $text, $default).choices(&[$($choice),+])
    };
    (@read $node:ident, $spec:ident, $type:ty, []) => {
        $spec.declare::<$type>($node)?
    };
    (@read $node:ident, $spec:ident, $type:ty, [$($choice:literal => $value:expr),+]) => {
        match $spec.declare::<::std::string::String>($node)?.as_str() {
            $($choice => $value,)+
            other => return ::std::result::Result::Err($spec.not_a_choice($node, other)),
        }
    };
}

#[cfg(test)]
mod tests {
    use super::*;

    parameters! {
        /// Of a test.
        #[expect(dead_code, reason = "only its table is looked at")]
        struct All {
            /// A number.
            /// Of two lines.
            number: u8 = 3;
            /// Another.
            other as "loop": f64 = 0.5, in 0.0..=1.0;
            /// A choice.
            choice: u32 = "one", one_of { "one" => 1, "two" => 2 };
            /// Topics.
            topics: Vec<String> = Vec::<String>::new();
            /// May change.
            steps: Parameter<i64> = 8, in 1..=64;
        }
    }

    #[test]
    fn a_table_says_all_that_there_is_to_say() {
        let specs = All::specs();
        let names: Vec<_> = specs.iter().map(|spec| spec.name).collect();
        assert_eq!(names, ["number", "loop", "choice", "topics", "steps"]);
        let [number, other, choice, topics, steps] = &specs[..] else {
            panic!("five parameters")
        };
        assert_eq!(number.descriptor.description, "A number. Of two lines.");
        assert_eq!(number.descriptor.range, Some(Range::from(0..=255)));
        assert_eq!(other.descriptor.range, Some(Range::from(0.0..=1.0)));
        assert_eq!(choice.default, Value::String("one".to_owned()));
        assert_eq!(choice.descriptor.choices, ["one", "two"]);
        assert_eq!(topics.default, Value::StringArray(Vec::new()));
        assert!(number.descriptor.read_only && !steps.descriptor.read_only);
    }
}
