//! Calls a node's reset service: `cargo run -p wm_ros --example reset -- /wm/predictor/reset 7`

use std::time::Duration;
use wm_msgs::wm_msgs::{Reset, ResetRequest};
use wm_ros::{ArgsError, Error, Node, NodeArgs};

fn main() -> Result<(), Error> {
    let args = NodeArgs::parse(std::env::args().skip(1))?;
    let [service, seed] = args.rest() else {
        return Err(ArgsError::Rest(args.rest().to_vec()).into());
    };
    let Ok(seed) = seed.parse() else {
        return Err(ArgsError::Rest(vec![seed.clone()]).into());
    };
    let service = service.clone();
    wm_ros::run(
        "reset_client",
        "/",
        &args,
        async |node: Node| -> Result<(), Error> {
            node.seal_parameters()?;
            let client = node.client::<Reset>(&service)?;
            let call = async {
                client.wait_for_service().await;
                client
                    .call(&ResetRequest {
                        seed,
                        keep_seed: false,
                    })
                    .await
            };
            match tokio::time::timeout(Duration::from_secs(10), call).await {
                Ok(response) => println!("{:?}", response?),
                Err(_elapsed) => tracing::error!("nobody answers {service}"),
            }
            Ok(())
        },
    )
}
