//! Package `rosbag2_interfaces`: the services of rosbag2's player and recorder, as in Jazzy and Kilted.

use super::builtin_interfaces::{Duration, Time};
use serde::{Deserialize, Serialize};

/// What a half of a service without fields is on the wire: IDL has no empty structs, so rosidl gives them one member.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Empty {
    /// Of no meaning.
    pub structure_needs_at_least_one_member: u8,
}

/// An answer that says whether it was done.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Success {
    /// Whether it was done.
    pub success: bool,
}

/// Service: hold the time of a player, or leave out what comes to a recorder.
#[derive(Clone, Copy, Debug)]
pub struct Pause;

/// Service: go on.
#[derive(Clone, Copy, Debug)]
pub struct Resume;

/// Service: pause what runs, resume what is paused.
#[derive(Clone, Copy, Debug)]
pub struct TogglePaused;

/// Service: whether it is paused.
#[derive(Clone, Copy, Debug)]
pub struct IsPaused;

/// What a server of [`IsPaused`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct IsPausedResponse {
    /// Whether it is.
    pub paused: bool,
}

/// Service: the rate of a player.
#[derive(Clone, Copy, Debug)]
pub struct GetRate;

/// A rate, asked for or answered.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Rate {
    /// Seconds of the bag in a second.
    pub rate: f64,
}

/// Service: play at this rate from now on.
#[derive(Clone, Copy, Debug)]
pub struct SetRate;

/// Service: publish the next message of a paused player.
#[derive(Clone, Copy, Debug)]
pub struct PlayNext;

/// Service: publish the next messages of a paused player, one right after the other.
#[derive(Clone, Copy, Debug)]
pub struct Burst;

/// What a client of [`Burst`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BurstRequest {
    /// How many; 0: all that are left.
    pub num_messages: u64,
}

/// What a server of [`Burst`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct BurstResponse {
    /// How many were published.
    pub actually_burst: u64,
}

/// Service: go on playing from another time of the bag.
#[derive(Clone, Copy, Debug)]
pub struct Seek;

/// What a client of [`Seek`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct SeekRequest {
    /// The bag's time.
    pub time: Time,
}

/// Service: begin a playback where none is under way.
#[derive(Clone, Copy, Debug)]
pub struct Play;

/// What a client of [`Play`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct PlayRequest {
    /// How much of the bag's beginning is left out.
    pub start_offset: Time,
    /// How much of the bag is played from there.
    pub playback_duration: Duration,
    /// The bag's time at which it ends.
    pub playback_until_timestamp: Time,
}

/// Service: end the playback, or the recording.
#[derive(Clone, Copy, Debug)]
pub struct Stop;

/// Service: write what a recorder in snapshot mode holds.
#[derive(Clone, Copy, Debug)]
pub struct Snapshot;

/// Service: begin the bag's next file.
#[derive(Clone, Copy, Debug)]
pub struct SplitBagfile;

/// Service: begin a recording where none is under way.
#[derive(Clone, Copy, Debug)]
pub struct Record;

/// What a client of [`Record`] sends.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordRequest {
    /// Folder of the new bag; empty: that of the recorder's options.
    pub uri: String,
}

/// What a server of [`Record`] answers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RecordResponse {
    /// 0, or 1 where it could not begin.
    pub return_code: i32,
    /// Why not.
    pub error_string: String,
}

macro_rules! services {
    ($($type:ident($request:ty) -> $response:ty, [$($field:ty),*];)*) => {
        $(service!(
            $type,
            "rosbag2_interfaces",
            include_str!(concat!("../../rosbag2_interfaces/srv/", stringify!($type), ".srv")),
            $request,
            $response,
            [$($field),*]
        );)*
    };
}

services! {
    Pause(Empty) -> Empty, [];
    Resume(Empty) -> Empty, [];
    TogglePaused(Empty) -> Empty, [];
    IsPaused(Empty) -> IsPausedResponse, [];
    GetRate(Empty) -> Rate, [];
    SetRate(Rate) -> Success, [];
    PlayNext(Empty) -> Success, [];
    Burst(BurstRequest) -> BurstResponse, [];
    Seek(SeekRequest) -> Success, [Time];
    Play(PlayRequest) -> Success, [Time, Duration];
    Stop(Empty) -> Empty, [];
    Snapshot(Empty) -> Success, [];
    SplitBagfile(Empty) -> Empty, [];
    Record(RecordRequest) -> RecordResponse, [];
}
