//! A whole node in a few lines: answers every text on `/wm/text` in capitals on `/wm/shout`, and forgets its count
//! when `/wm/shout_node/reset` is called.
//!
//! `cargo run -p wm_ros --example shout -- --ros-args -p suffix:=?`

use wm_msgs::{
    std_msgs,
    wm_msgs::{Reset, ResetResponse},
};
use wm_ros::{Descriptor, Error, Node, NodeArgs, Qos};

fn main() -> Result<(), Error> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    args.expect_no_rest()?;
    wm_ros::run("shout_node", "/wm", &args, body)
}

async fn body(node: Node) -> Result<(), Error> {
    let suffix = node.declare(
        "suffix",
        "!".to_owned(),
        Descriptor::new("what is put behind a text"),
    )?;
    let times = node.declare(
        "times",
        1_i64,
        Descriptor::new("how often a text is said").integers(1, 3),
    )?;
    node.declare(
        "voice",
        "alto".to_owned(),
        Descriptor::new("fixed once the node runs").read_only(),
    )?;
    node.seal_parameters()?;

    let mut texts = node.subscription::<std_msgs::String>("text", Qos::best_effort(10))?;
    let mut resets = node.service::<Reset>("~/reset")?;
    let shouts = node.publisher::<std_msgs::String>("shout", Qos::reliable(10))?;
    let counts = node.publisher::<std_msgs::String>("shout/count", Qos::latched(1))?;
    let mut count = 0;
    tracing::info!("listening on {}", texts.topic());
    loop {
        tokio::select! {
            received = texts.recv() => {
                let Some(received) = received else { return Ok(()) };
                let said = received.message.data.to_uppercase() + &suffix.get();
                for _ in 0..times.get() {
                    shouts.publish(&std_msgs::String { data: said.clone() })?;
                    count += 1;
                }
                counts.publish(&std_msgs::String { data: count.to_string() })?;
            }
            Some(call) = resets.recv() => {
                call.respond(&ResetResponse { success: true, message: format!("forgot {count}") })?;
                count = 0;
            }
        }
    }
}
