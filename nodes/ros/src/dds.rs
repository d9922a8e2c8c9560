//! The DDS middleware: rustdds for the wire, ros2-client for what ROS 2 adds to it (names, and the announcement of
//! which node an endpoint belongs to).
//!
//! What is minded here, each at its place:
//! - a reliable writer's window is bounded ([`qos::RELIABLE_WINDOW`]), since KeepLast alone would let a stopped
//!   reader hold 8192 samples in memory;
//! - ros2-client's own node and spinner are not used: its `/clock` has the wrong type, its parameters no
//!   descriptors, and its spinner keeps the participant alive;
//! - a participant's writers and readers are connected here, since rustdds does not do it on loopback;
//! - the participant goes last, after its readers and writers, or the others never hear that it left.

mod answers;
mod codec;
mod datagram;
mod endpoint;
mod local;
mod mismatches;
mod nodes;
mod qos;

use crate::{
    Environment, Error, Qos, Reach,
    backend::{Backend, Channel, Endpoint, EndpointId, Reader, Seen, Sink, Writer},
};
use endpoint::{DdsReader, DdsWriter};
use futures::StreamExt as _;
use local::{Local, is_same_participant};
use mismatches::Mismatches;
use nodes::Nodes;
use ros2_client::MessageTypeName;
use rustdds::{
    DomainParticipant, DomainParticipantBuilder, DomainParticipantStatusEvent as Event,
    RTPSEntity as _, StatusEvented as _,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
};
use tokio::{runtime::Handle, sync::watch};

/// Endpoints of others by the own endpoint that they are connected to.
type Matches = BTreeMap<EndpointId, BTreeSet<EndpointId>>;

/// A participant of a DDS domain.
pub(crate) struct Dds {
    id: EndpointId,
    /// `None` once closed.
    participant: Mutex<Option<DomainParticipant>>,
    publisher: rustdds::Publisher,
    subscriber: rustdds::Subscriber,
    shared: Arc<Shared>,
    runtime: Handle,
}

/// What the endpoints need of their participant, and keep alive for as long as they are held.
struct Shared {
    nodes: Nodes,
    local: Local,
    /// Connections to other participants.
    matches: Mutex<Matches>,
    /// Writers of other participants that have not gone.
    writers: Mutex<BTreeSet<EndpointId>>,
    mismatches: Mismatches,
    is_on_loopback: bool,
    /// The largest answer to a client that is not on loopback \[byte\].
    largest_answer: usize,
    changes: watch::Sender<u64>,
}

impl Shared {
    fn changed(&self) {
        self.changes.send_modify(|count| *count += 1);
    }

    /// The largest answer that reaches this client \[byte\].
    fn largest_answer(&self, own: &EndpointId, client: &EndpointId) -> usize {
        match self.is_on_loopback && !is_foreign(own, client) {
            true => datagram::LARGEST_ON_LOOPBACK,
            false => self.largest_answer,
        }
    }

    /// Whether this writer of another participant is still there.
    fn is_there(&self, writer: &EndpointId) -> bool {
        lock(&self.writers).contains(writer)
    }

    /// Takes an endpoint off every list.
    fn forget(&self, id: &EndpointId) {
        self.local.remove(id);
        lock(&self.matches).remove(id);
        self.mismatches.forget_own(id);
        self.nodes.remove_endpoint(id);
        self.changed();
    }
}

/// Whether the two are of different DDS implementations: an identity begins with its vendor's two bytes (RTPS 2.5, 8.2.4.3).
fn is_foreign(one: &EndpointId, other: &EndpointId) -> bool {
    one.get(..2) != other.get(..2)
}

/// What a lock guards is whole between statements, so a panic elsewhere is no reason to stop.
fn lock<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

impl Dds {
    /// Joins the domain. `runtime` runs what receives; it must be stopped before [`Backend::close`].
    pub(crate) fn join(environment: &Environment, runtime: Handle) -> Result<Arc<Self>, Error> {
        let failed =
            |error| Error::middleware(format!("join DDS domain {}", environment.domain_id), error);
        let mut builder = DomainParticipantBuilder::new(environment.domain_id);
        if let Some(addresses) = environment.addresses() {
            builder = builder.with_only_networks(addresses);
        }
        if environment.reach == Reach::Process {
            // without it, it would announce itself to the first participants of this host
            builder = builder.same_host_loopback(false);
        }
        let participant = builder.build().map_err(failed)?;
        let defaults = rustdds::QosPolicyBuilder::new().build();
        let publisher = participant.create_publisher(&defaults).map_err(failed)?;
        let subscriber = participant.create_subscriber(&defaults).map_err(failed)?;
        let shared = Arc::new(Shared {
            nodes: Nodes::announce(&participant, &publisher)?,
            local: Local::default(),
            matches: Mutex::default(),
            writers: Mutex::default(),
            mismatches: Mismatches::default(),
            is_on_loopback: matches!(environment.reach, Reach::Localhost | Reach::Process),
            largest_answer: datagram::largest_answer(),
            changes: watch::Sender::new(0),
        });
        runtime.spawn(follow(participant.status_listener(), Arc::clone(&shared)));
        Ok(Arc::new(Self {
            id: participant.guid().to_bytes(),
            participant: Mutex::new(Some(participant)),
            publisher,
            subscriber,
            shared,
            runtime,
        }))
    }

    fn topic(
        &self,
        endpoint: &Endpoint,
        qos: &rustdds::QosPolicies,
    ) -> Result<rustdds::Topic, Error> {
        let participant = lock(&self.participant);
        let Some(participant) = participant.as_ref() else {
            return Err(Error::ShutDown(endpoint.name.clone()));
        };
        participant
            .create_topic(
                dds_name(endpoint),
                dds_type(endpoint),
                qos,
                rustdds::TopicKind::NoKey,
            )
            .map_err(|error| {
                Error::middleware(format!("create the topic {}", endpoint.name), error)
            })
    }
}

/// ROS 2's spelling of a name in DDS: <https://design.ros2.org/articles/topic_and_service_names.html>.
fn dds_name(endpoint: &Endpoint) -> String {
    match endpoint.channel {
        Channel::Topic => format!("rt{}", endpoint.name),
        Channel::Request => format!("rq{}Request", endpoint.name),
        Channel::Response => format!("rr{}Reply", endpoint.name),
    }
}

fn dds_type(endpoint: &Endpoint) -> String {
    let (package, name) = (&endpoint.type_name.package, &endpoint.type_name.name);
    match endpoint.channel {
        Channel::Topic => MessageTypeName::new(package, name).dds_msg_type(),
        Channel::Request => format!("{package}::srv::dds_::{name}_Request_"),
        Channel::Response => format!("{package}::srv::dds_::{name}_Response_"),
    }
}

/// What a DDS topic is to ROS, its ROS name and its type; `None` for what is not ROS'.
fn ros_names(dds_name: &str, dds_type: &str) -> Option<(Channel, String, String)> {
    let (prefix, rest) = dds_name.split_at_checked(2)?;
    let (channel, name, kind, suffix) = match prefix {
        "rt" => (Channel::Topic, rest, "msg", "_"),
        "rq" => (
            Channel::Request,
            rest.strip_suffix("Request")?,
            "srv",
            "_Request_",
        ),
        "rr" => (
            Channel::Response,
            rest.strip_suffix("Reply")?,
            "srv",
            "_Response_",
        ),
        _ => return None,
    };
    let (package, type_name) = dds_type
        .strip_suffix(suffix)?
        .split_once(&format!("::{kind}::dds_::"))?;
    (name.starts_with('/') && name.len() > 1).then(|| {
        (
            channel,
            name.to_owned(),
            format!("{package}/{kind}/{type_name}"),
        )
    })
}

/// Keeps the book of who is connected to whom, from the participant's events.
async fn follow(listener: rustdds::DomainParticipantStatusListener, shared: Arc<Shared>) {
    let mut events = listener.as_async_status_stream();
    while let Some(event) = events.next().await {
        match event {
            Event::RemoteReaderMatched {
                local_writer: own,
                remote_reader: other,
            }
            | Event::RemoteWriterMatched {
                local_reader: own,
                remote_writer: other,
            } => {
                let (own, other) = (own.to_bytes(), other.to_bytes());
                if is_same_participant(&own, &other) {
                    continue;
                }
                lock(&shared.matches).entry(own).or_default().insert(other);
            }
            Event::ReaderLost { guid, .. } | Event::WriterLost { guid, .. } => {
                shared.mismatches.forget_other(&guid.to_bytes());
                lock(&shared.writers).remove(&guid.to_bytes());
                for others in lock(&shared.matches).values_mut() {
                    others.remove(&guid.to_bytes());
                }
            }
            Event::RemoteReaderQosIncompatible {
                local_writer,
                remote_reader,
                requested_qos,
                offered_qos,
            } => {
                let (own, other) = (local_writer.to_bytes(), remote_reader.to_bytes());
                let topic = shared.nodes.topic_of(&own);
                shared
                    .mismatches
                    .subscription(own, other, topic, &requested_qos, &offered_qos);
            }
            Event::RemoteWriterQosIncompatible {
                local_reader,
                remote_writer,
                requested_qos,
                offered_qos,
            } => {
                let (own, other) = (local_reader.to_bytes(), remote_writer.to_bytes());
                let topic = shared.nodes.topic_of(&own);
                shared
                    .mismatches
                    .publisher(own, other, topic, &requested_qos, &offered_qos);
            }
            Event::WriterDetected { writer } => {
                lock(&shared.writers).insert(writer.guid.to_bytes());
            }
            Event::ReaderDetected { .. } => {}
            _ => continue,
        }
        shared.changed();
    }
}

impl Backend for Dds {
    fn participant(&self) -> EndpointId {
        self.id
    }

    fn add_node(&self, namespace: &str, base: &str) -> Result<(), Error> {
        self.shared.nodes.add(namespace, base)
    }

    fn remove_node(&self, namespace: &str, base: &str) {
        self.shared.nodes.remove(namespace, base);
    }

    fn writer(&self, node: &str, endpoint: &Endpoint) -> Result<Box<dyn Writer>, Error> {
        let qos = qos::for_writer(endpoint.qos);
        let topic = self.topic(endpoint, &qos)?;
        let writer = self
            .publisher
            .create_datawriter_no_key(&topic, Some(qos))
            .map_err(|error| Error::middleware(format!("publish {}", endpoint.name), error))?;
        Ok(Box::new(DdsWriter::new(
            writer,
            endpoint,
            node,
            &self.shared,
            &self.runtime,
        )))
    }

    fn reader(
        &self,
        node: &str,
        endpoint: &Endpoint,
        sink: Sink,
    ) -> Result<Box<dyn Reader>, Error> {
        let qos = qos::for_reader(endpoint.qos);
        let topic = self.topic(endpoint, &qos)?;
        let began = rustdds::Timestamp::now();
        let reader = self
            .subscriber
            .create_simple_datareader_no_key(&topic, Some(qos))
            .map_err(|error| Error::middleware(format!("subscribe to {}", endpoint.name), error))?;
        Ok(Box::new(DdsReader::new(
            reader,
            began,
            endpoint,
            node,
            &self.shared,
            sink,
            &self.runtime,
        )))
    }

    fn seen(&self) -> Vec<Seen> {
        let mut seen = self.shared.nodes.own_endpoints();
        let participant = lock(&self.participant);
        let Some(participant) = participant.as_ref() else {
            return seen;
        };
        let mut see = |guid: rustdds::GUID, name: &str, dds_type: &str, qos, is_writer| {
            let id = guid.to_bytes();
            // Where multicast reflects them, a participant discovers its own endpoints too.
            if is_same_participant(&self.id, &id) {
                return;
            }
            if let Some((channel, name, type_name)) = ros_names(name, dds_type) {
                seen.push(Seen {
                    channel,
                    name,
                    type_name,
                    qos,
                    is_writer,
                    id,
                    is_own: false,
                });
            }
        };
        for writer in participant.discovered_writers() {
            let (guid, topic) = (
                writer.writer_proxy.remote_writer_guid,
                &writer.publication_topic_data,
            );
            let qos = qos::from_dds(&topic.qos());
            see(guid, &topic.topic_name, &topic.type_name, qos, true);
        }
        for reader in participant.discovered_readers() {
            let (guid, topic) = (
                reader.reader_proxy.remote_reader_guid,
                &reader.subscription_topic_data,
            );
            let qos = qos::from_dds(&topic.qos());
            see(guid, topic.topic_name(), topic.type_name(), qos, false);
        }
        seen
    }

    fn matched(&self, endpoint: &EndpointId) -> usize {
        let elsewhere = lock(&self.shared.matches)
            .get(endpoint)
            .map_or(0, BTreeSet::len);
        elsewhere + self.shared.local.matched(endpoint)
    }

    fn foreign(&self, endpoint: &EndpointId) -> usize {
        let matches = lock(&self.shared.matches);
        let others = matches.get(endpoint).into_iter().flatten();
        others.filter(|other| is_foreign(endpoint, other)).count()
    }

    fn mismatches(&self, endpoint: &EndpointId) -> Vec<String> {
        self.shared.mismatches.of(endpoint)
    }

    fn changes(&self) -> watch::Receiver<u64> {
        self.shared.changes.subscribe()
    }

    fn is_alive(&self) -> bool {
        // The thread that does discovery takes the command, or is gone: rustdds 0.15.1 ends its threads where the
        // system interrupts their waiting, as it does when a process is stopped and continued.
        let participant = lock(&self.participant);
        let asserted = participant
            .as_ref()
            .map(DomainParticipant::assert_liveliness);
        asserted.is_none_or(|asserted| asserted.is_ok())
    }

    fn close(&self) {
        self.shared.nodes.leave();
        let participant = lock(&self.participant).take();
        drop(participant);
    }
}

impl From<Qos> for rustdds::policy::Reliability {
    fn from(qos: Qos) -> Self {
        match qos.reliability {
            crate::Reliability::BestEffort => Self::BestEffort,
            // zero: a full window is reported at once instead of blocking the node
            crate::Reliability::Reliable => Self::Reliable {
                max_blocking_time: rustdds::Duration::ZERO,
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::names::TypeName;

    fn endpoint(channel: Channel) -> Endpoint {
        Endpoint {
            channel,
            name: "/wm/predictor/reset".into(),
            type_name: TypeName {
                package: "wm_msgs".into(),
                name: "Reset".into(),
            },
            qos: Qos::reliable(10),
            hears_own: true,
        }
    }

    #[test]
    fn names_are_spelled_as_every_rmw_spells_them() {
        assert_eq!(dds_name(&endpoint(Channel::Topic)), "rt/wm/predictor/reset");
        assert_eq!(
            dds_name(&endpoint(Channel::Request)),
            "rq/wm/predictor/resetRequest"
        );
        assert_eq!(
            dds_name(&endpoint(Channel::Response)),
            "rr/wm/predictor/resetReply"
        );
        assert_eq!(
            dds_type(&endpoint(Channel::Topic)),
            "wm_msgs::msg::dds_::Reset_"
        );
        assert_eq!(
            dds_type(&endpoint(Channel::Response)),
            "wm_msgs::srv::dds_::Reset_Response_"
        );
    }

    #[tokio::test(flavor = "multi_thread")]
    async fn an_answer_waits_until_its_client_can_hear_it() {
        const PATIENCE: std::time::Duration = std::time::Duration::from_secs(20);
        let environment = Environment {
            domain_id: 100 + (std::process::id() % 20) as u16,
            reach: crate::Reach::Localhost,
        };
        let join = || Dds::join(&environment, Handle::current()).unwrap();
        let (server, client) = (join(), join());
        let (calls, mut called) = tokio::sync::mpsc::unbounded_channel();
        let sink = move |sample: Result<crate::backend::Sample, String>| {
            calls.send(sample.unwrap().request.unwrap()).unwrap();
        };
        let _requests = server
            .reader("/server", &endpoint(Channel::Request), Box::new(sink))
            .unwrap();
        let answers = server
            .writer("/server", &endpoint(Channel::Response))
            .unwrap();
        let requests = client
            .writer("/client", &endpoint(Channel::Request))
            .unwrap();
        let sample = bytes::Bytes::from_static(&[0, 1, 0, 0, 7, 0, 0, 0]);

        let mut changes = client.changes();
        while client.matched(&requests.id()) == 0 {
            tokio::time::timeout(PATIENCE, changes.changed())
                .await
                .unwrap()
                .unwrap();
        }
        requests.write(&sample, None).unwrap();
        let request = tokio::time::timeout(PATIENCE, called.recv())
            .await
            .unwrap()
            .unwrap();
        // The client has no reader yet: an answer sent now would reach nobody.
        let written = answers.write(&sample, Some(request)).unwrap();
        assert_eq!(written, crate::backend::Written::Held);

        let (heard, mut hears) = tokio::sync::mpsc::unbounded_channel();
        let sink = move |sample: Result<crate::backend::Sample, String>| {
            heard.send(sample.unwrap().bytes).unwrap();
        };
        let _answers = client
            .reader("/client", &endpoint(Channel::Response), Box::new(sink))
            .unwrap();
        let answer = tokio::time::timeout(PATIENCE, hears.recv())
            .await
            .unwrap()
            .unwrap();
        assert_eq!(answer, sample);
    }

    #[test]
    fn names_are_read_back_and_what_is_not_ros_is_not() {
        for channel in [Channel::Topic, Channel::Request, Channel::Response] {
            let endpoint = endpoint(channel);
            let kind = match channel {
                Channel::Topic => "msg",
                Channel::Request | Channel::Response => "srv",
            };
            let expected = (
                channel,
                endpoint.name.clone(),
                format!("wm_msgs/{kind}/Reset"),
            );
            let read = ros_names(&dds_name(&endpoint), &dds_type(&endpoint));
            assert_eq!(read, Some(expected));
        }
        assert_eq!(ros_names("rq/a/b", "x::srv::dds_::B_Request_"), None);
        assert_eq!(
            ros_names(
                "ros_discovery_info",
                "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
            ),
            None
        );
        assert_eq!(ros_names("rt", "a::msg::dds_::B_"), None);
    }
}
