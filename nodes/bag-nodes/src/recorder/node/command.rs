//! What a recorder is asked for while it runs: the services of rosbag2's recorder, under its own name, and keys.

use crate::keyboard::Key;
use wm_msgs::rosbag2_interfaces::{IsPaused, Pause, Record, Resume, Snapshot, SplitBagfile, Stop};
use wm_ros::calls::Calls;
use wm_ros::{Call, Error, Node};

/// A call or a key.
pub(super) enum Command {
    Pause(Call<Pause>),
    Resume(Call<Resume>),
    IsPaused(Call<IsPaused>),
    Snapshot(Call<Snapshot>),
    SplitBagfile(Call<SplitBagfile>),
    Record(Call<Record>),
    Stop(Call<Stop>),
    Key(Key),
}

/// Serves the recorder's services; `~/snapshot`, as rosbag2 does it, in snapshot mode alone.
pub(super) fn serve(node: &Node, is_snapshot: bool) -> Result<Calls<Command>, Error> {
    let mut calls = Calls::new(node);
    calls.serve("pause", Command::Pause)?;
    calls.serve("resume", Command::Resume)?;
    calls.serve("is_paused", Command::IsPaused)?;
    calls.serve("split_bagfile", Command::SplitBagfile)?;
    calls.serve("record", Command::Record)?;
    calls.serve("stop", Command::Stop)?;
    if is_snapshot {
        calls.serve("snapshot", Command::Snapshot)?;
    }
    Ok(calls)
}
