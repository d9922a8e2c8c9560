//! What a player is asked for while it plays: the services of rosbag2's player, under its own name, and keys.

use crate::keyboard::Key;
use wm_msgs::rosbag2_interfaces::{
    Burst, GetRate, IsPaused, Pause, Play, PlayNext, Resume, Seek, SetRate, Stop, TogglePaused,
};
use wm_ros::calls::Calls;
use wm_ros::{Call, Error, Node};

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

/// Serves the player's services.
pub(super) fn serve(node: &Node) -> Result<Calls<Command>, Error> {
    let mut calls = Calls::new(node);
    calls.serve("pause", Command::Pause)?;
    calls.serve("resume", Command::Resume)?;
    calls.serve("toggle_paused", Command::TogglePaused)?;
    calls.serve("is_paused", Command::IsPaused)?;
    calls.serve("get_rate", Command::GetRate)?;
    calls.serve("set_rate", Command::SetRate)?;
    calls.serve("play_next", Command::PlayNext)?;
    calls.serve("burst", Command::Burst)?;
    calls.serve("seek", Command::Seek)?;
    calls.serve("play", Command::Play)?;
    calls.serve("stop", Command::Stop)?;
    Ok(calls)
}
