//! A test whose Zenoh sessions find each other through a router of their own.
//!
//! Sessions read their router's address from `ZENOH_CONFIG_OVERRIDE`, which a process has only once. So such a test runs
//! in a process of its own: this test program again, with only that test.

use super::harness::{fresh_domain, fresh_endpoint};
use hiroz::{Builder as _, context::ZContextBuilder, node::ZNode};
use std::{process::Command, sync::Arc};
use wm_ros::{Context, Environment, Middleware, Node, NodeArgs, Reach};
use zenoh::Wait as _;

/// The router's endpoint, in the process of the test.
const ROUTER: &str = "WM_TEST_ROUTER";

/// Runs `test`, the body of the test function `name`, with the endpoint of a router. `name` includes its modules.
pub fn with_router(name: &str, test: impl AsyncFnOnce(&str)) {
    if let Ok(endpoint) = std::env::var(ROUTER) {
        // Zenoh refuses blocking calls in a runtime of one thread
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .unwrap();
        runtime.block_on(test(&endpoint));
        return;
    }
    let endpoint = fresh_endpoint();
    let mut config = wm_ros::zenoh::router_config().unwrap();
    let endpoints = format!("[\"{endpoint}\"]");
    config.insert_json5("listen/endpoints", &endpoints).unwrap();
    let router = zenoh::open(config).wait().unwrap();
    let settings = format!("connect/endpoints={endpoints}");
    let status = Command::new(std::env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture"])
        .env(ROUTER, &endpoint)
        .env("ROS_DOMAIN_ID", fresh_domain().to_string())
        .env("RMW_IMPLEMENTATION", "rmw_zenoh_cpp")
        .env("ZENOH_CONFIG_OVERRIDE", settings)
        .env_remove("ZENOH_SESSION_CONFIG_URI")
        .status()
        .unwrap();
    router.close().wait().unwrap();
    assert!(status.success(), "{name}: {status}");
}

/// The ROS domain of the test.
fn domain() -> u16 {
    std::env::var("ROS_DOMAIN_ID").unwrap().parse().unwrap()
}

/// A node of wm with these arguments, and its context.
pub fn wm_node(name: &str, arguments: &[&str]) -> (Context, Node) {
    let environment = Environment {
        domain_id: domain(),
        reach: Reach::Localhost,
        middleware: Middleware::Zenoh,
    };
    let context = Context::new(&environment).unwrap();
    let arguments = NodeArgs::parse(arguments.iter().copied()).unwrap();
    let node = Node::new(&context, name, "/wm", &arguments).unwrap();
    (context, node)
}

/// A node of hiroz in a session of its own.
pub fn hiroz_node(name: &str) -> Arc<ZNode> {
    let context = ZContextBuilder::default().with_domain_id(usize::from(domain()));
    let context = context.build().unwrap();
    Arc::new(context.create_node(name).build().unwrap())
}
