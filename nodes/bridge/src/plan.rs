//! Which routes are needed: a pure function of what this side's nodes do, and what the other bridges announce.

use crate::{
    announcement::{Announcement, MAX_DEPTH, Subject},
    settings::Settings,
};
use std::collections::BTreeMap;
use wm_ros::{Durability, Qos, Reliability, RemoteEndpoint, Role};

/// What a route carries, and which way.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Direction {
    /// A topic of this side's publishers to Zenoh.
    Outgoing,
    /// A topic from Zenoh to this side's subscriptions.
    Incoming,
    /// A service of this side to callers on Zenoh.
    Served,
    /// A service on Zenoh to this side's clients.
    Called,
}

/// Minimum number of samples of a latched topic from Zenoh that are kept for late joiners: several publishers may share the
/// topic. It is also the assumed depth of subscriptions whose DDS does not announce one. So a subscription that joins or
/// leaves does not change the route, whose new writer would send every subscription its samples again.
const LEAST_LATCHED: usize = 10;

/// Names a route.
#[derive(Clone, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct RouteId {
    /// The way.
    pub direction: Direction,
    /// The topic's or service's name on this side.
    pub name: String,
}

/// A route that is to be.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Route {
    /// `package/msg/Type` or `package/srv/Type`.
    pub type_name: String,
    /// Of the bridge's own reader or writer on this side; of no meaning for a service.
    pub qos: Qos,
    /// Whether nodes of this side take part, whom the bridge then announces on Zenoh. Their QoS.
    pub local: Option<Qos>,
    /// Whether another bridge has announced the other end.
    pub is_remote: bool,
}

/// The routes for these endpoints of this side and these announcements of other bridges.
pub fn plan(
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
        // The role that this side's nodes would have.
        let (direction, role, qos) = match announcement.subject {
            Subject::Publisher(qos) => (Direction::Incoming, Role::Subscription, qos),
            Subject::Server => (Direction::Called, Role::Client, Qos::reliable(1)),
            // A route for a subscriber or client of theirs begins with a publisher or server of ours.
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
    // Where this side serves a service itself, its clients are to get one answer, not two.
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
            // A reliable writer matches every reader, as the real bridge has it.
            route.qos.reliability = Reliability::Reliable;
            if route.qos.durability == Durability::TransientLocal {
                route.qos.depth = route.qos.depth.max(LEAST_LATCHED);
            }
        }
    }
    routes
}

/// Adds an end to its route. Of two types under one name the first stays; ROS connects no two types either.
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
        // A reader hears all writers where it requests what the weakest offers,
        Direction::Outgoing => Demand::Least,
        // a writer is heard by all readers where it offers what the strongest requests.
        _ => Demand::Most,
    };
    route.qos = merged(route.qos, other.qos, demand);
}

/// Which of two levels of service is taken.
#[derive(Clone, Copy)]
enum Demand {
    Least,
    Most,
}

/// One QoS for two endpoints; its history is the deeper of theirs.
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
    fn the_reader_of_a_topic_hears_every_publisher_and_the_writer_reaches_every_subscription() {
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
    fn what_others_publish_and_serve_appears_here_under_its_name() {
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
    fn a_subscription_that_comes_or_goes_does_not_make_a_latched_route_another() {
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
    fn a_service_of_this_side_is_not_fetched_from_the_other() {
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
