//! What a player can be asked for while it plays: by keys, and by the services of rosbag2's player under its own name.

use crate::keyboard::Key;
use wm_msgs::rosbag2_interfaces::{
    Burst, GetRate, IsPaused, Pause, Play, PlayNext, Resume, Seek, SetRate, Stop, TogglePaused,
};
use wm_ros::calls::Calls;
use wm_ros::{Call, EndpointSet as _, Error, Node, Service};

/// A call or a key.
pub(super) enum Command {
    Pause(Call<Pause>),
    Resume(Call<Resume>),
    TogglePaused(Call<TogglePaused>),
    IsPaused(Call<IsPaused>),
    GetRate(Call<GetRate>),
    SetRate(Call<SetRate>),
    PlayNext(Call<PlayNext>),
    Burst(Call<Burst>),
    Seek(Call<Seek>),
    Play(Call<Play>),
    Stop(Call<Stop>),
    Key(Key),
}

wm_ros::endpoints! {
    /// The services of rosbag2's player.
    pub(super) struct Services {
        /// Pauses the playback.
        pause: Service<Pause> = "~/pause";
        /// Resumes the playback.
        resume: Service<Resume> = "~/resume";
        /// Pauses or resumes the playback.
        toggle_paused: Service<TogglePaused> = "~/toggle_paused";
        /// Whether the playback is paused.
        is_paused: Service<IsPaused> = "~/is_paused";
        /// Playback rate: seconds of the bag per second.
        get_rate: Service<GetRate> = "~/get_rate";
        /// Sets the playback rate.
        set_rate: Service<SetRate> = "~/set_rate";
        /// Plays the next message of a paused playback.
        play_next: Service<PlayNext> = "~/play_next";
        /// Plays the next messages of a paused playback.
        burst: Service<Burst> = "~/burst";
        /// Jumps to a time of the bag.
        seek: Service<Seek> = "~/seek";
        /// Starts a new playback, from the beginning or of a part.
        play: Service<Play> = "~/play";
        /// Ends the playback.
        stop: Service<Stop> = "~/stop";
    }
}

/// Serves them.
pub(super) fn serve(node: &Node) -> Result<Calls<Command>, Error> {
    let services = Services::make(node)?;
    let mut calls = Calls::default();
    calls.add(services.pause, Command::Pause);
    calls.add(services.resume, Command::Resume);
    calls.add(services.toggle_paused, Command::TogglePaused);
    calls.add(services.is_paused, Command::IsPaused);
    calls.add(services.get_rate, Command::GetRate);
    calls.add(services.set_rate, Command::SetRate);
    calls.add(services.play_next, Command::PlayNext);
    calls.add(services.burst, Command::Burst);
    calls.add(services.seek, Command::Seek);
    calls.add(services.play, Command::Play);
    calls.add(services.stop, Command::Stop);
    Ok(calls)
}
