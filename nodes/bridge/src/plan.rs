//! Plans the routes: a pure function of this side's endpoints and the other bridges' announcements.

use crate::{
    announcement::{Announcement, MAX_DEPTH, Subject},
    settings::Settings,
};
use std::collections::BTreeMap;
use wm_ros::{Durability, Qos, Reliability, RemoteEndpoint, Role};

/// The kind and direction of a route.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) enum Direction {
    /// A topic from publishers of this side to Zenoh.
    Outgoing,
    /// A topic from Zenoh to subscriptions of this side.
    Incoming,
    /// A service of this side for callers on Zenoh.
    Served,
    /// A service on Zenoh for clients of this side.
    Called,
}

/// The least number of samples of a latched topic from Zenoh that are kept for late subscribers, since several
/// publishers may share the topic. It is also the assumed depth of subscriptions whose DDS announces none. So a
/// subscription that joins or leaves does not change the route; a new writer would repeat its samples to all
/// subscriptions.
const LEAST_LATCHED: usize = 10;

#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct RouteId {
    pub direction: Direction,
    /// The topic's or service's name on this side.
    pub name: String,
}

/// A planned route.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(crate) struct Route {
    /// `package/msg/Type` or `package/srv/Type`.
    pub type_name: String,
    /// Of the bridge's own reader or writer on this side; unused for services.
    pub qos: Qos,
    /// The QoS of this side's endpoints, if there are any. The bridge then announces them on Zenoh.
    pub local: Option<Qos>,
    /// Whether another bridge has announced the other end.
    pub is_remote: bool,
}

/// Plans routes for the endpoints of this side and the announcements of other bridges.
pub(crate) fn plan(
    endpoints: &[RemoteEndpoint],
    announcements: &[Announcement],
    settings: &Settings,
) -> BTreeMap<RouteId, Route> {
    let mut routes = BTreeMap::new();
    for endpoint in endpoints {
        let direction = match endpoint.role {
            Role::Publisher => Direction::Outgoing,
            Role::Subscription => Direction::Incoming,
            Role::Server => Direction::Served,
            Role::Client => Direction::Called,
        };
        let seen = Route {
            type_name: endpoint.type_name.clone(),
            qos: Qos {
                depth: endpoint.qos.depth.min(MAX_DEPTH),
                ..endpoint.qos
            },
            local: Some(endpoint.qos),
            is_remote: false,
        };
        if settings.admits(endpoint.role, &endpoint.name) {
            join(&mut routes, direction, &endpoint.name, seen);
        }
    }
    for announcement in announcements {
        // the role of this side's nodes
        let (direction, role, qos) = match announcement.subject {
            Subject::Publisher(qos) => (Direction::Incoming, Role::Subscription, qos),
            Subject::Server => (Direction::Called, Role::Client, Qos::reliable(1)),
            // a route for a remote subscriber or client begins with an own publisher or server
            Subject::Subscriber(_) | Subject::Client => continue,
        };
        let name = settings.namespace.name_of(&announcement.key);
        let announced = Route {
            type_name: announcement.type_name.clone(),
            qos,
            local: None,
            is_remote: true,
        };
        if settings.admits(role, &name) {
            join(&mut routes, direction, &name, announced);
        }
    }
    // if this side serves a service itself, its clients must get one response, not two
    let served: Vec<String> = routes
        .keys()
        .filter(|id| id.direction == Direction::Served)
        .map(|id| id.name.clone())
        .collect();
    for name in served {
        routes.remove(&RouteId {
            direction: Direction::Called,
            name,
        });
    }
    for (id, route) in &mut routes {
        if id.direction == Direction::Incoming {
            // as in the real bridge: a reliable writer matches every reader
            route.qos.reliability = Reliability::Reliable;
            if route.qos.durability == Durability::TransientLocal {
                route.qos.depth = route.qos.depth.max(LEAST_LATCHED);
            }
        }
    }
    routes
}

/// Adds an endpoint to its route. If types differ, the first one stays; ROS does not connect them either.
fn join(routes: &mut BTreeMap<RouteId, Route>, direction: Direction, name: &str, other: Route) {
    let id = RouteId {
        direction,
        name: name.to_owned(),
    };
    let Some(route) = routes.get_mut(&id) else {
        routes.insert(id, other);
        return;
    };
    if route.type_name != other.type_name {
        return;
    }
    route.is_remote |= other.is_remote;
    let local = [route.local, other.local].into_iter().flatten();
    route.local = local.reduce(|one, other| merged(one, other, Demand::Least));
    let demand = match direction {
        // a reader matches all writers if it requests the weakest offer
        Direction::Outgoing => Demand::Least,
        // a writer matches all readers if it offers the strongest request
        _ => Demand::Most,
    };
    route.qos = merged(route.qos, other.qos, demand);
}

/// Which of two levels of service to use.
#[derive(Clone, Copy)]
enum Demand {
    Least,
    Most,
}

/// Merges two QoS, with the deeper history.
fn merged(one: Qos, other: Qos, demand: Demand) -> Qos {
    let either = |one: bool, other: bool| match demand {
        Demand::Least => one && other,
        Demand::Most => one || other,
    };
    let is_reliable = |qos: Qos| qos.reliability == Reliability::Reliable;
    let is_latched = |qos: Qos| qos.durability == Durability::TransientLocal;
    Qos {
        reliability: match either(is_reliable(one), is_reliable(other)) {
            true => Reliability::Reliable,
            false => Reliability::BestEffort,
        },
        durability: match either(is_latched(one), is_latched(other)) {
            true => Durability::TransientLocal,
            false => Durability::Volatile,
        },
        depth: one.depth.max(other.depth),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::settings::{Options, Section};

    fn endpoint(role: Role, name: &str, qos: Qos) -> RemoteEndpoint {
        let type_name = match role {
            Role::Publisher | Role::Subscription => "std_msgs/msg/String",
            Role::Server | Role::Client => "wm_msgs/srv/Reset",
        };
        RemoteEndpoint {
            role,
            name: name.into(),
            type_name: type_name.into(),
            qos,
            participant: [1; 12],
        }
    }

    fn announced(subject: Subject, key: &str) -> Announcement {
        let type_name = match subject {
            Subject::Publisher(_) | Subject::Subscriber(_) => "std_msgs/msg/String",
            Subject::Server | Subject::Client => "wm_msgs/srv/Reset",
        };
        Announcement {
            bridge: "b".into(),
            subject,
            key: key.into(),
            type_name: type_name.into(),
        }
    }

    fn planned(
        endpoints: &[RemoteEndpoint],
        announcements: &[Announcement],
        options: Options,
    ) -> Vec<(Direction, String, Route)> {
        let settings = Settings::new(Section::default(), options).unwrap();
        plan(endpoints, announcements, &settings)
            .into_iter()
            .map(|(id, route)| (id.direction, id.name, route))
            .collect()
    }

    #[test]
    fn route_qos_matches_every_publisher_and_subscription() {
        let endpoints = [
            endpoint(Role::Publisher, "/a", Qos::latched(1)),
            endpoint(Role::Publisher, "/a", Qos::best_effort(i32::MAX as usize)),
            endpoint(Role::Subscription, "/b", Qos::best_effort(10)),
            endpoint(Role::Subscription, "/b", Qos::latched(5)),
        ];
        let routes = planned(&endpoints, &[], Options::default());
        let [
            (Direction::Outgoing, _, out),
            (Direction::Incoming, _, into),
        ] = &routes[..]
        else {
            panic!("{routes:?}");
        };
        assert_eq!(out.qos, Qos::best_effort(MAX_DEPTH));
        assert_eq!(into.qos, Qos::latched(10));
        assert!(!into.is_remote);
    }

    #[test]
    fn remote_topics_and_services_appear_under_their_names() {
        let announcements = [
            announced(Subject::Publisher(Qos::latched(3)), "robot1/a"),
            announced(Subject::Server, "robot1/reset"),
            announced(Subject::Subscriber(Qos::reliable(3)), "robot1/c"),
            announced(Subject::Client, "robot1/d"),
        ];
        let options = Options {
            namespace: Some("/robot1".into()),
            ..Options::default()
        };
        let routes = planned(&[], &announcements, options);
        let [
            (Direction::Incoming, topic, into),
            (Direction::Called, service, called),
        ] = &routes[..]
        else {
            panic!("{routes:?}");
        };
        assert_eq!((topic.as_str(), service.as_str()), ("/a", "/reset"));
        assert_eq!((into.qos, into.local), (Qos::latched(10), None));
        assert!(called.is_remote && called.local.is_none());
    }

    #[test]
    fn subscriptions_do_not_change_a_latched_route() {
        let announcements = [announced(Subject::Publisher(Qos::latched(1)), "a")];
        let subscription = endpoint(Role::Subscription, "/a", Qos::latched(10));
        let qos = |endpoints: &[RemoteEndpoint]| {
            planned(endpoints, &announcements, Options::default())[0]
                .2
                .qos
        };
        assert_eq!(qos(&[]), qos(&[subscription]));
    }

    #[test]
    fn own_service_is_not_fetched_from_the_other_side() {
        let endpoints = [
            endpoint(Role::Server, "/reset", Qos::reliable(10)),
            endpoint(Role::Client, "/reset", Qos::reliable(10)),
        ];
        let announcements = [announced(Subject::Server, "reset")];
        let routes = planned(&endpoints, &announcements, Options::default());
        assert_eq!(routes.len(), 1);
        assert_eq!(routes[0].0, Direction::Served);
    }

    #[test]
    fn lists_hold_for_both_sides() {
        let endpoints = [
            endpoint(Role::Publisher, "/a", Qos::reliable(1)),
            endpoint(Role::Publisher, "/b", Qos::reliable(1)),
        ];
        let announcements = [
            announced(Subject::Publisher(Qos::reliable(1)), "a"),
            announced(Subject::Publisher(Qos::reliable(1)), "c"),
        ];
        let options = Options {
            allow: vec!["/a".into()],
            ..Options::default()
        };
        let routes = planned(&endpoints, &announcements, options);
        assert!(routes.iter().all(|(_, name, _)| name == "/a"), "{routes:?}");
        assert_eq!(routes.len(), 2);
    }
}
