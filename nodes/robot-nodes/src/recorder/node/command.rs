//! What a recorder can be asked for while it runs: by keys, and by the services of rosbag2's recorder, under its own
//! name.

use crate::keyboard::Key;
use wm_msgs::rosbag2_interfaces::{IsPaused, Pause, Record, Resume, Snapshot, SplitBagfile, Stop};
use wm_ros::calls::Calls;
use wm_ros::{Call, EndpointSet as _, Error, Node, Service};

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

wm_ros::endpoints! {
    /// The services of rosbag2's recorder.
    pub(super) struct Services {
        /// Pauses the recording.
        pause: Service<Pause> = "~/pause";
        /// Resumes the recording.
        resume: Service<Resume> = "~/resume";
        /// Whether the recording is paused.
        is_paused: Service<IsPaused> = "~/is_paused";
        /// Starts the bag's next file.
        split_bagfile: Service<SplitBagfile> = "~/split_bagfile";
        /// Starts another bag after ~/stop.
        record: Service<Record> = "~/record";
        /// Closes the bag.
        stop: Service<Stop> = "~/stop";
        /// Writes the messages in memory. Only in snapshot mode, as in rosbag2.
        snapshot: Option<Service<Snapshot>> = "~/snapshot", made(|node, name, _| {
            match node.parameter("snapshot_mode")? {
                true => node.service(name).map(Some),
                false => Ok(None),
            }
        });
    }
}

/// Serves them.
pub(super) fn serve(node: &Node) -> Result<Calls<Command>, Error> {
    let services = Services::make(node)?;
    let mut calls = Calls::default();
    calls.add(services.pause, Command::Pause);
    calls.add(services.resume, Command::Resume);
    calls.add(services.is_paused, Command::IsPaused);
    calls.add(services.split_bagfile, Command::SplitBagfile);
    calls.add(services.record, Command::Record);
    calls.add(services.stop, Command::Stop);
    if let Some(snapshot) = services.snapshot {
        calls.add(snapshot, Command::Snapshot);
    }
    Ok(calls)
}
