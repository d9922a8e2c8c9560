//! The nodes of the suite as identities, from their own tables of endpoints.

use super::identity::Identity;
use crate::{
    launch::{CAMERA, plan_of},
    node::{self, Definition, TOGETHER},
};
use anyhow::{Context as _, Result, bail};
use std::path::Path;
use wm_bag::BagReader;
use wm_camera::camera_info::info_topic;
use wm_launch::{Process, Program};
use wm_ros::{ChosenTopics, Direction, GraphNode, NAMESPACE, NodeArgs, Role};

/// The decoder's and the view's topic beside the pictures.
const CAMERA_INFO: &str = "/camera/camera_info";

/// A node, its endpoints, and whether the topics of its bag are missing.
struct OwnNode {
    node: GraphNode,
    lacks_topics: bool,
}

/// These nodes, or every node if none is named, each as a process of its own.
pub(super) fn of_nodes(only: &[String], namespace: &str, args: &NodeArgs) -> Result<Vec<Identity>> {
    let here = Path::new("");
    let identity = |definition| {
        let own = own_node(definition, namespace, args, here)?;
        Ok(single(own))
    };
    match only {
        [] => node::definitions().map(identity).collect(),
        only => only
            .iter()
            .map(|name| identity(definition(name)?))
            .collect(),
    }
}

/// One process of these nodes.
pub(super) fn together(names: &[&str], namespace: &str, args: &NodeArgs) -> Result<Identity> {
    let mut nodes = Vec::new();
    for name in names {
        let own = own_node(definition(name)?, namespace, args, Path::new(""))?;
        nodes.push(own.node);
    }
    Ok(Identity::new(name_of(&nodes), nodes))
}

/// The processes of a launch file that are nodes of the suite.
pub(super) fn of_launch(file: &Path, arguments: &[(String, String)]) -> Result<Vec<Identity>> {
    let plan = plan_of(file, arguments.to_vec())?;
    let mut identities = Vec::new();
    for process in &plan.processes {
        identities.extend(of_process(process)?);
    }
    Ok(identities)
}

/// The suite's nodes in a process of a launch file; `None` for other programs.
///
/// # Errors
/// Invalid arguments of a node, or a bag that cannot be read.
pub(super) fn of_process(process: &Process) -> Result<Option<Identity>> {
    let is_own = process.program == Program::Own;
    let Some((first, _)) = process.arguments.split_first().filter(|_| is_own) else {
        return Ok(None);
    };
    if first != TOGETHER && !node::is_node(first) {
        return Ok(None);
    }
    let args = NodeArgs::parse(process.arguments.iter().cloned())?;
    let folder = process.working_directory.as_deref();
    let folder = folder.unwrap_or(Path::new(""));
    let names = args.rest().iter().filter(|word| node::is_node(word));
    let nodes = names.map(|name| own_node(definition(name)?, NAMESPACE, &args, folder));
    let mut nodes = nodes
        .collect::<Result<Vec<_>>>()
        .with_context(|| process.name.clone())?;
    let identity = match nodes.len() {
        1 if first != TOGETHER => single(nodes.remove(0)),
        _ => {
            let nodes: Vec<_> = nodes.into_iter().map(|own| own.node).collect();
            Identity::new(name_of(&nodes), nodes)
        }
    };
    Ok(Some(identity))
}

/// The definition of a node of the suite.
fn definition(name: &str) -> Result<&'static Definition> {
    match node::definition(name) {
        Some(definition) => Ok(definition),
        None => bail!("`{name}` is not a node of wm: `wm nodes` lists them"),
    }
}

fn single(own: OwnNode) -> Identity {
    let mut identity = Identity::new(own.node.name.clone(), vec![own.node]);
    identity.lacks_topics = own.lacks_topics;
    identity
}

/// The name of a process with these nodes: `/wm/encoder` and `/wm/decoder` are `/wm/run.encoder.decoder`. A certificate
/// limits it to 64 bytes, so letters are dropped from longer names, at the end.
fn name_of(nodes: &[GraphNode]) -> String {
    let first = nodes.first().map(|node| &*node.name).unwrap_or_default();
    let (namespace, _) = first.rsplit_once('/').unwrap_or_default();
    let bases = nodes.iter().filter_map(|node| node.name.rsplit('/').next());
    let mut name = format!("{namespace}/{TOGETHER}");
    for base in bases {
        name.push('.');
        name.push_str(base);
    }
    name.truncate(64);
    name
}

fn own_node(
    definition: &Definition,
    namespace: &str,
    args: &NodeArgs,
    folder: &Path,
) -> Result<OwnNode> {
    let mut node = definition.in_graph(args, namespace)?;
    add_camera(&mut node, definition, namespace, args)?;
    let mut lacks_topics = false;
    match definition.chosen_topics {
        ChosenTopics::None => {}
        ChosenTopics::Subscribed => {
            node.add(Role::Subscription, "/**".to_owned());
            node.add(Role::Client, "/**/get_type_description".to_owned());
        }
        ChosenTopics::Published => {
            let bag: Option<String> = args.given(definition.name, namespace, "bag")?;
            match bag.filter(|bag| !bag.is_empty()) {
                None => lacks_topics = true,
                Some(bag) => {
                    let bag = folder.join(bag);
                    let reader =
                        BagReader::open(&bag).with_context(|| bag.display().to_string())?;
                    for topic in reader.topics() {
                        let name = args.resolve(definition.name, namespace, &topic.name)?;
                        node.add(Role::Publisher, name);
                    }
                }
            }
        }
    }
    Ok(OwnNode { node, lacks_topics })
}

/// The camera of the parameter `camera_topic` or of a remapping rule. Its `camera_info` is beside its pictures.
fn add_camera(
    node: &mut GraphNode,
    definition: &Definition,
    namespace: &str,
    args: &NodeArgs,
) -> Result<()> {
    let specs = (definition.endpoints)();
    let subscribes = |name: &str| {
        let mut specs = specs.iter();
        specs.any(|spec| spec.name == name && spec.direction == Direction::Subscribed)
    };
    let (has_images, has_info) = (subscribes(CAMERA), subscribes(CAMERA_INFO));
    if !has_images && !has_info {
        return Ok(());
    }
    let has_parameter = (definition.parameters)()
        .iter()
        .any(|spec| spec.name == "camera_topic");
    let given: Option<String> = match has_parameter {
        true => args.given(definition.name, namespace, "camera_topic")?,
        false => None,
    };
    let topic = given.filter(|topic| !topic.is_empty());
    let topic = topic.as_deref().unwrap_or(CAMERA);
    let images = args.resolve(definition.name, namespace, topic)?;
    let compressed = args.resolve_sibling(definition.name, namespace, topic, "compressed")?;
    if has_info {
        node.add(Role::Subscription, info_topic(&images));
    }
    // the decoder subscribes to the pictures too, to compare their sizes with camera_info
    node.add(Role::Subscription, images);
    node.add(Role::Subscription, compressed);
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn identity(name: &str, line: &str) -> Identity {
        let args = NodeArgs::parse(line.split_whitespace()).unwrap();
        let identities = of_nodes(&[], "/wm", &args).unwrap();
        let mut found = identities.into_iter().filter(|known| known.name == name);
        found.next().unwrap()
    }

    fn names(identity: &Identity, role: Role) -> Vec<&str> {
        identity.names(role).collect()
    }

    #[test]
    fn encoder_publishes_what_its_table_declares() {
        let encoder = identity("/wm/encoder", "");
        let expected = [
            "/diagnostics",
            "/parameter_events",
            "/rosout",
            "/wm/camera_state",
            "/wm/encoder/transition_event",
            "/wm/latent",
        ];
        assert_eq!(names(&encoder, Role::Publisher), expected);
        let expected = [
            "/camera/image_raw",
            "/camera/image_raw/compressed",
            "/clock",
            "/parameter_events",
            "/wm/action",
            "/wm/model",
        ];
        assert_eq!(names(&encoder, Role::Subscription), expected);
        assert!(names(&encoder, Role::Client).is_empty());
    }

    #[test]
    fn remapped_names_replace_the_tables() {
        let rules = "--ros-args -r /camera/image_raw:=/front/image_raw -r __ns:=/left -r action:=/arm/action";
        let decoder = identity("/left/decoder", rules);
        let subscribed = names(&decoder, Role::Subscription);
        assert!(subscribed.contains(&"/front/camera_info"), "{subscribed:?}");
        let encoder = identity("/left/encoder", rules);
        let subscribed = names(&encoder, Role::Subscription);
        for topic in [
            "/front/image_raw",
            "/front/image_raw/compressed",
            "/arm/action",
        ] {
            assert!(subscribed.contains(&topic), "{topic}: {subscribed:?}");
        }
        assert!(!subscribed.contains(&"/front/camera_info"));
        assert!(names(&encoder, Role::Publisher).contains(&"/left/latent"));
    }

    #[test]
    fn view_follows_the_parameter_of_its_camera() {
        let view = identity(
            "/wm/view",
            "--ros-args -p view:camera_topic:=/top/image_raw",
        );
        let subscribed = names(&view, Role::Subscription);
        for topic in [
            "/top/image_raw",
            "/top/image_raw/compressed",
            "/top/camera_info",
        ] {
            assert!(subscribed.contains(&topic), "{topic}: {subscribed:?}");
        }
        assert!(names(&view, Role::Client).contains(&"/wm/executor/stop"));
    }

    #[test]
    fn player_publishes_the_topics_of_its_bag() {
        let bag = concat!(env!("CARGO_MANIFEST_DIR"), "/../../bags/tabletop");
        let player = identity("/wm/player", &format!("--ros-args -p player:bag:={bag}"));
        let published = names(&player, Role::Publisher);
        assert!(published.contains(&"/wm/action"), "{published:?}");
        assert!(!player.lacks_topics && player.note().is_none());
        let without = identity("/wm/player", "");
        assert!(
            without
                .note()
                .unwrap()
                .contains("--node /wm/player=publish:")
        );
    }

    #[test]
    fn process_of_several_nodes_has_their_rights() {
        let args = NodeArgs::parse(std::iter::empty::<&str>()).unwrap();
        let both = together(&["encoder", "predictor"], "/wm", &args).unwrap();
        assert_eq!(both.name, "/wm/run.encoder.predictor");
        let published = names(&both, Role::Publisher);
        assert!(published.contains(&"/wm/latent") && published.contains(&"/wm/predicted"));
        assert!(together(&["encoder", "camera"], "/wm", &args).is_err());
    }

    #[test]
    fn launch_file_names_the_processes() {
        let file = concat!(
            env!("CARGO_MANIFEST_DIR"),
            "/../../launch-configs/replay.launch.yaml"
        );
        let with = |argument: (&str, &str)| {
            let arguments = [(argument.0.to_owned(), argument.1.to_owned())];
            of_launch(Path::new(file), &arguments).unwrap()
        };
        let identities = with(("action", "/arm/action"));
        let has = |name: &str| identities.iter().find(|known| known.name == name);
        let predictor = has("/wm/predictor").unwrap();
        assert!(names(predictor, Role::Subscription).contains(&"/arm/action"));
        assert!(!has("/wm/player").unwrap().lacks_topics);
        let together = with(("one_process", "true"));
        let name = "/wm/run.encoder.predictor.decoder.planner";
        assert!(together.iter().any(|known| known.name == name));
    }
}
