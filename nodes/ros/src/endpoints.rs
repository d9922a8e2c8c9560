//! Topics, services and actions, each declared once: a table of name, type, QoS and description. The endpoints and `wm
//! NODE --help` are made from it.

use crate::{ActionServer, Client, Error, Node, Publisher, Qos, Service, Subscription};
use wm_msgs::{Action, Message};

/// The direction of an endpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Direction {
    /// A topic that the node subscribes to.
    Subscribed,
    /// A topic that the node publishes.
    Published,
    /// A service that the node has.
    Served,
    /// An action that the node has.
    Performed,
    /// A service that the node calls.
    Called,
}

/// The declaration of a topic, service or action, without a node.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct EndpointSpec {
    /// Its direction.
    pub direction: Direction,
    /// The name before namespace and remapping.
    pub name: String,
    /// `package/msg/Type`, `package/srv/Type` or `package/action/Type`.
    pub type_name: String,
    /// The QoS of a topic; `None` for services and actions.
    pub qos: Option<Qos>,
    /// What it carries.
    pub text: String,
}

/// A Rust type that holds an endpoint.
pub trait Endpoint: Sized {
    /// The declarations for this name: one endpoint, or several siblings.
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec>;

    /// Makes it.
    ///
    /// # Errors
    /// A name that ROS does not allow, or the middleware failed.
    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, Error>;
}

/// A set of endpoints, which [`endpoints!`](crate::endpoints) makes.
pub trait EndpointSet: Sized {
    /// All of them, in the order in which they are documented.
    fn specs() -> Vec<EndpointSpec>;

    /// Makes them on `node`.
    ///
    /// # Errors
    /// As [`Endpoint::make`].
    fn make(node: &Node) -> Result<Self, Error>;
}

/// No endpoints.
impl EndpointSet for () {
    fn specs() -> Vec<EndpointSpec> {
        Vec::new()
    }

    fn make(_: &Node) -> Result<Self, Error> {
        Ok(())
    }
}

impl EndpointSpec {
    /// A topic of messages `M`.
    pub fn topic<M: Message>(direction: Direction, name: &str, qos: Qos, text: &str) -> Self {
        Self {
            direction,
            name: name.to_owned(),
            type_name: M::ros_name(),
            qos: Some(qos),
            text: text.trim().to_owned(),
        }
    }

    /// A service `S`, served or called.
    pub fn service<S: wm_msgs::Service>(direction: Direction, name: &str, text: &str) -> Self {
        Self {
            direction,
            name: name.to_owned(),
            type_name: S::ros_name(),
            qos: None,
            text: text.trim().to_owned(),
        }
    }
}

impl<M: Message> Endpoint for Subscription<M> {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        vec![EndpointSpec::topic::<M>(
            Direction::Subscribed,
            name,
            qos,
            text,
        )]
    }

    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, Error> {
        node.subscription(name, qos)
    }
}

impl<M: Message> Endpoint for Publisher<M> {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        vec![EndpointSpec::topic::<M>(
            Direction::Published,
            name,
            qos,
            text,
        )]
    }

    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, Error> {
        node.publisher(name, qos)
    }
}

impl<S: wm_msgs::Service> Endpoint for Service<S> {
    fn specs(name: &str, _: Qos, text: &str) -> Vec<EndpointSpec> {
        vec![EndpointSpec::service::<S>(Direction::Served, name, text)]
    }

    fn make(node: &Node, name: &str, _: Qos) -> Result<Self, Error> {
        node.service(name)
    }
}

impl<S: wm_msgs::Service> Endpoint for Client<S> {
    fn specs(name: &str, _: Qos, text: &str) -> Vec<EndpointSpec> {
        vec![EndpointSpec::service::<S>(Direction::Called, name, text)]
    }

    fn make(node: &Node, name: &str, _: Qos) -> Result<Self, Error> {
        node.client(name)
    }
}

impl<A: Action> Endpoint for ActionServer<A> {
    fn specs(name: &str, _: Qos, text: &str) -> Vec<EndpointSpec> {
        vec![EndpointSpec {
            direction: Direction::Performed,
            name: name.to_owned(),
            type_name: A::ros_name(),
            qos: None,
            text: text.trim().to_owned(),
        }]
    }

    fn make(node: &Node, name: &str, _: Qos) -> Result<Self, Error> {
        node.action_server(name)
    }
}

/// An endpoint that is made under a condition.
impl<T: Endpoint> Endpoint for Option<T> {
    fn specs(name: &str, qos: Qos, text: &str) -> Vec<EndpointSpec> {
        T::specs(name, qos, text)
    }

    fn make(node: &Node, name: &str, qos: Qos) -> Result<Self, Error> {
        T::make(node, name, qos).map(Some)
    }
}

/// Makes a struct of endpoints, and its [`EndpointSet`], from a table: doc comment, field, type and name, then the QoS
/// (reliable, depth 10, if none is given). With `if`, an `Option` is made only under a condition; with `made`, a
/// closure makes the endpoint. A field without a name is a set of endpoints.
///
/// A table of an enum has the services and actions, one variant for each. A variant holds a request with its reply handle: a
/// [`Call`](crate::Call) or a [`GoalRequest`](crate::GoalRequest). [`Requests`](crate::Requests) of the enum is a set of
/// endpoints, which gives the requests one after the other.
///
/// ```
/// use wm_msgs::std_msgs::String as Text;
/// use wm_msgs::wm_msgs::{Reset, ResetResponse, action};
/// use wm_ros::{ActionServer, EndpointSet as _, Node, Publisher, Qos, Requests, Service, Subscription};
///
/// wm_ros::endpoints! {
///     /// Topics and services.
///     struct Endpoints {
///         /// Texts to shout.
///         texts: Subscription<Text> = "text", qos(Qos::best_effort(5));
///         /// The texts in capitals, unless quiet.
///         shouts: Option<Publisher<Text>> = "shout", if(|node| Ok(!node.parameter("quiet")?));
///         /// Requests of clients.
///         requests: Requests<Request>;
///     }
/// }
///
/// wm_ros::endpoints! {
///     /// Requests of clients.
///     enum Request {
///         /// Starts again.
///         Reset(Service<Reset>) = "~/reset", made(|node, name, _| {
///             node.service_or_refuse(name, |reason| ResetResponse { success: false, message: reason.to_owned() })
///         });
///         /// Plans once.
///         Plan(ActionServer<action::Plan>) = "~/plan";
///     }
/// }
///
/// async fn obey(endpoints: &mut Endpoints) {
///     match endpoints.requests.next_request().await {
///         Some(Request::Reset(call)) => wm_ros::answer(call, &ResetResponse { success: true, message: String::new() }),
///         Some(Request::Plan(goal)) => goal.reject(),
///         None => {} // the shutdown
///     }
/// }
///
/// let types: Vec<_> = Endpoints::specs().into_iter().map(|spec| spec.type_name).collect();
/// assert_eq!(types[1..], ["std_msgs/msg/String", "wm_msgs/srv/Reset", "wm_msgs/action/Plan"]);
/// ```
#[macro_export]
macro_rules! endpoints {
    (
        $(#[$attribute:meta])*
        $visibility:vis struct $set:ident {
            $(
                $(#[doc = $text:literal])+
                $field_visibility:vis $field:ident : $type:ty
                    $(= $name:expr $(, qos($qos:expr))? $(, if($condition:expr))? $(, made($make:expr))?)?
            );* $(;)?
        }
    ) => {
        $(#[$attribute])*
        $visibility struct $set {
            $($(#[doc = $text])+ $field_visibility $field: $type,)*
        }

        impl $crate::EndpointSet for $set {
            fn specs() -> ::std::vec::Vec<$crate::EndpointSpec> {
                let sets: ::std::vec::Vec<::std::vec::Vec<$crate::EndpointSpec>> = ::std::vec![$(
                    $crate::endpoints!(@specs $type, [$($name)?] [$($($qos)?)?] ::std::concat!($($text),+))
                ),*];
                sets.into_iter().flatten().collect()
            }

            fn make(node: &$crate::Node) -> ::std::result::Result<Self, $crate::Error> {
                ::std::result::Result::Ok(Self {
                    $($field: $crate::endpoints!(@make node, $type, [$($name)?] [$($($qos)?)?] [$($(if $condition)?)?] [$($($make)?)?])?,)*
                })
            }
        }
    };
    (
        $(#[$attribute:meta])*
        $visibility:vis enum $set:ident {
            $(
                $(#[doc = $text:literal])+
                $variant:ident($type:ty) = $name:expr $(, if($condition:expr))? $(, made($make:expr))?
            );* $(;)?
        }
    ) => {
        $(#[$attribute])*
        $visibility enum $set {
            $($(#[doc = $text])+ $variant(<$type as $crate::RequestEndpoint>::Request),)*
        }

        impl $crate::RequestSet for $set {
            fn specs() -> ::std::vec::Vec<$crate::EndpointSpec> {
                let sets: ::std::vec::Vec<::std::vec::Vec<$crate::EndpointSpec>> = ::std::vec![$(
                    $crate::endpoints!(@specs $type, [$name] [] ::std::concat!($($text),+))
                ),*];
                sets.into_iter().flatten().collect()
            }

            fn sources(
                node: &$crate::Node,
            ) -> ::std::result::Result<::std::vec::Vec<::std::boxed::Box<dyn $crate::RequestSource<Self>>>, $crate::Error>
            {
                let sources = [$(
                    <$type as $crate::RequestEndpoint>::source(
                        $crate::endpoints!(@make node, $type, [$name] [] [$(if $condition)?] [$($make)?])?,
                        $set::$variant,
                    )
                ),*];
                ::std::result::Result::Ok(sources.into_iter().flatten().collect())
            }
        }
    };
    (@qos) => { $crate::Qos::reliable(10) };
    (@qos $qos:expr) => { $qos };
    (@specs $type:ty, [] [] $text:expr) => { <$type as $crate::EndpointSet>::specs() };
    (@specs $type:ty, [$name:expr] [$($qos:expr)?] $text:expr) => {
        <$type as $crate::Endpoint>::specs($name, $crate::endpoints!(@qos $($qos)?), $text)
    };
    (@make $node:ident, $type:ty, [] [] [] []) => { <$type as $crate::EndpointSet>::make($node) };
    (@make $node:ident, $type:ty, [$name:expr] [$($qos:expr)?] [] []) => {
        <$type as $crate::Endpoint>::make($node, $name, $crate::endpoints!(@qos $($qos)?))
    };
    (@make $node:ident, $type:ty, [$name:expr] [$($qos:expr)?] [if $condition:expr] []) => {
        $crate::make_if($condition, $node, $name, $crate::endpoints!(@qos $($qos)?))
    };
    (@make $node:ident, $type:ty, [$name:expr] [$($qos:expr)?] [] [$make:expr]) => {
        $crate::made_by::<$type, _>($make)($node, $name, $crate::endpoints!(@qos $($qos)?))
    };
}

/// Makes an endpoint under a condition of [`endpoints!`](crate::endpoints).
#[doc(hidden)]
pub fn make_if<T: Endpoint>(
    condition: impl FnOnce(&Node) -> Result<bool, Error>,
    node: &Node,
    name: &str,
    qos: Qos,
) -> Result<Option<T>, Error> {
    condition(node)?
        .then(|| T::make(node, name, qos))
        .transpose()
}

/// Gives the compiler the type of the closure of [`endpoints!`](crate::endpoints).
#[doc(hidden)]
pub fn made_by<T, F: FnOnce(&Node, &str, Qos) -> Result<T, Error>>(make: F) -> F {
    make
}
