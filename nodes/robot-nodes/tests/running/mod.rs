//! Nodes that run in threads of their own.

#![allow(clippy::unwrap_used, reason = "a test's helpers may fail the test")]
#![allow(dead_code, reason = "not every test needs all of them")]

use std::thread::JoinHandle;

use wm_ros::{Context, Environment, Node, NodeArgs, Reach};

/// A participant on loopback, in a domain of its own for each test of a file: neither tests nor runs meet each other.
pub fn context(test: u16) -> Context {
    assert!(test < 8, "the domains of another run begin there");
    let domain_id = 20 + (std::process::id() % 10) as u16 * 8 + test;
    let reach = Reach::Localhost;
    Context::new(&Environment { domain_id, reach }).unwrap()
}

/// A node of the test itself.
pub fn node(context: &Context, name: &str, words: &str) -> Node {
    let args = NodeArgs::parse(words.split_whitespace()).unwrap();
    Node::new(context, name, wm_ros::NAMESPACE, &args).unwrap()
}

/// Runs a node until its context ends.
pub fn start(
    context: &Context,
    name: &'static str,
    words: &str,
    body: impl AsyncFnOnce(Node) -> anyhow::Result<()> + Send + 'static,
) -> JoinHandle<anyhow::Result<()>> {
    let (context, words) = (context.clone(), words.to_owned());
    std::thread::spawn(move || {
        let args = NodeArgs::parse(words.split_whitespace()).unwrap();
        let node = Node::new(&context, name, wm_ros::NAMESPACE, &args)?;
        tokio::runtime::Builder::new_current_thread()
            .enable_all()
            .build()?
            .block_on(body(node))
    })
}

/// The words of a node with these parameters.
pub fn with(parameters: &str) -> String {
    match parameters {
        "" => String::new(),
        parameters => format!("--ros-args {parameters}"),
    }
}
