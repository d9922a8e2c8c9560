//! Workarounds for faults and gaps of rustdds 0.15.1, each with the test that fails without it. Paths of tests are relative
//! to `nodes/ros/`.
//!
//! | file | fault of rustdds | test | removed by |
//! |---|---|---|---|
//! | [`addresses`] | announces and joins multicast only on the addresses found at its start | `tests/peers/hosts.rs` | a participant that follows changes of addresses |
//! | [`catch_up`] | sends announcements without timestamps, so Fast DDS loses those that a newer one overtakes | `tests/peers/newcomers.rs` | timestamps on announcements |
//! | [`datagram`], [`wire`] | shifts the inline QoS of fragments by a byte: large responses never arrive | `tests/peers/answers.rs` | correct inline QoS in DATA_FRAG |
//! | [`introduction`] | announces itself to twelve participants of a host without multicast | `dds/tests.rs`: `participants_beyond_the_twelfth_discover_each_other` | announcements to all participant numbers |
//! | [`latched`] | (follows from [`line`]: a publisher has several DDS writers) | `tests/peers/laggards.rs` | the removal of [`line`] |
//! | [`lease`] | lets its own lease run out, and remembers announcements of lost participants | `tests/peers/hosts.rs` | a participant that exempts itself, and forgets lost participants |
//! | [`line`], [`window`] | one reader without acknowledgements stops a reliable writer for all | `tests/peers/laggards.rs` | a writer that drops samples or readers |
//! | [`one_way`], [`renewal`] | does not repeat announcements to participants that lost this one | `tests/peers/hosts.rs` | repeated announcements to readers that return |
//! | [`parts`] | sends fragments, and repairs them, in bursts that overflow receive buffers | `tests/large_messages.rs`, `parts/tests.rs` | flow control in the writer |
//! | [`reconcile`] | drops discovery events if its channel of 2048 is full | `dds/tests.rs`: `lost_discovery_events_are_repaired` | a channel that reports loss |
//! | [`rematch`] | does not connect to the endpoints of a participant that returns | `tests/peers/hosts.rs` | connections at the return of a participant |
//! | [`resend`] | repairs 2 KiB in 10 ms | `tests/peers/hosts.rs` | faster repairs |
//! | [`rtps`] | has no API for the messages of the other files | its own tests | the removal of its users |
//! | [`second_participant`] | sends nothing to its own readers on loopback, and waits for their acknowledgements | `tests/graph.rs` | delivery within a participant |
//! | [`socket_filter`] | binds its sockets to every address | `tests/peers/strangers.rs` | sockets bound to the requested addresses |
//! | [`wall_clock`] | orders received samples by the wall clock | `tests/peers/clock.rs` | a monotonic clock in its cache |
//!
//! Two more are in files with other purposes: `dds/writer.rs` delays the departure of a writer (`HAND_OVER`), since rustdds
//! forgets its last samples with it; `dds/reader.rs` drops samples older than a reader, since rustdds keeps a topic's last
//! samples for all readers.

pub(super) mod addresses;
pub(super) mod catch_up;
pub(super) mod datagram;
pub(super) mod introduction;
pub(super) mod latched;
pub(super) mod lease;
pub(super) mod line;
pub(super) mod one_way;
pub(super) mod parts;
pub(super) mod reconcile;
mod rematch;
mod renewal;
pub(super) mod resend;
pub(super) mod rtps;
mod second_participant;
pub(super) mod socket_filter;
pub(super) mod wall_clock;
mod window;
pub(super) mod wire;
