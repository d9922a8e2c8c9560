//! `wm-bridge-peer CONFIG`: the real zenoh-bridge-ros2dds for the tests of `wm-bridge`. Its plugin is linked in and
//! started as in its own program. The configuration is a JSON5 text instead of options.
//!
//! The plugin reads `ROS_DOMAIN_ID`, `ROS_DISTRO` and `CYCLONEDDS_URI`.

use anyhow::{Context as _, Result, anyhow};
use zenoh::{
    Config,
    internal::{plugins::PluginsManager, runtime::RuntimeBuilder},
};
use zenoh_plugin_ros2dds::ROS2Plugin;

/// Settings that the real program always sets.
const ALWAYS: [(&str, &str); 3] = [
    // latched topics are kept by time
    ("timestamping/enabled", "true"),
    ("adminspace/enabled", "true"),
    ("plugins_loading/enabled", "true"),
];

#[tokio::main]
async fn main() -> Result<()> {
    zenoh::init_log_from_env_or("warn");
    let text = std::env::args()
        .nth(1)
        .context("usage: wm-bridge-peer CONFIG")?;
    let of_config = |error| anyhow!("the configuration: {error}");
    let mut config = Config::from_json5(&text).map_err(of_config)?;
    for (key, value) in ALWAYS {
        config.insert_json5(key, value).map_err(of_config)?;
    }
    let mut plugins = PluginsManager::static_plugins_only();
    plugins.declare_static_plugin::<ROS2Plugin, &str>("ros2dds", true);
    let failed = |error| anyhow!("Zenoh: {error}");
    let runtime = RuntimeBuilder::new(config).plugins_manager(plugins);
    let mut runtime = runtime.build().await.map_err(failed)?;
    runtime.start().await.map_err(failed)?;
    std::future::pending().await
}
