//! Passes a topic of any type on under another name, bytes untouched.
//!
//! `cargo run -p wm_ros --example relay -- /wm/latent /elsewhere/latent wm_msgs/msg/Latent`

use wm_ros::{ArgsError, Error, Node, NodeArgs, Qos};

fn main() -> Result<(), Error> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    let [from, to, type_name] = args.rest() else {
        return Err(ArgsError::Rest(args.rest().to_vec()).into());
    };
    let (from, to, type_name) = (from.clone(), to.clone(), type_name.clone());
    wm_ros::run(
        "relay",
        "/",
        &args,
        async |node: Node| -> Result<(), Error> {
            node.seal_parameters()?;
            let mut source = node.raw_subscription(&from, &type_name, Qos::best_effort(100))?;
            let sink = node.raw_publisher(&to, &type_name, Qos::reliable(10))?;
            let mut passed = 0;
            while let Some(received) = source.recv().await {
                sink.publish_when_ready(received.message).await?;
                passed += 1;
            }
            tracing::info!(
                "passed {passed}, not read in time {}, lost {}",
                source.dropped(),
                source.lost()
            );
            Ok(())
        },
    )
}
