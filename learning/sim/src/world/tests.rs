//! Interaction of hand and objects.

use super::*;
use crate::object::COLOURS;
use nalgebra::Vector2;

fn hand(x: f64, y: f64, z: f64, opening: f64, objects: Vec<Object>) -> World {
    let tool = ToolPose {
        position: Vector3::new(x, y, z),
        rpy: Vector3::zeros(),
    };
    World::new(objects, tool, opening)
}

fn action(x: f64, y: f64, z: f64, gripper: f64) -> EndEffectorAction {
    EndEffectorAction {
        translation: Vector3::new(x, y, z),
        rotation: Vector3::zeros(),
        gripper,
    }
}

fn cube(x: f64, y: f64) -> Object {
    let shape = Shape::Box {
        half_x: 0.02,
        half_y: 0.02,
        height: 0.04,
    };
    Object::standing(shape, COLOURS[0], x, y, 0.0)
}

#[test]
fn grasped_object_moves_with_the_hand() {
    let mut world = hand(0.25, 0.0, 0.015, 1.0, vec![cube(0.252, 0.004)]);
    for _ in 0..3 {
        world.step(&action(0.0, 0.0, 0.0, 0.0));
    }
    assert_eq!(world.held(), Some(0));
    let before = world.objects()[0].position() - world.tool().position;
    world.step(&action(0.02, -0.03, 0.04, 0.0));
    let after = world.objects()[0].position() - world.tool().position;
    assert!((after - before).norm() < 1e-9);
    assert!(world.objects()[0].position().z > 0.035);
    // It falls when released.
    for _ in 0..2 {
        world.step(&action(0.0, 0.0, 0.0, 1.0));
    }
    assert_eq!(world.held(), None);
    assert!(world.objects()[0].position().z.abs() < 1e-9);
}

#[test]
fn pushed_object_moves_along_the_push() {
    let mut world = hand(0.20, 0.0, 0.015, 0.0, vec![cube(0.26, 0.003)]);
    for _ in 0..4 {
        world.step(&action(0.03, 0.0, 0.0, 0.0));
    }
    let object = &world.objects()[0];
    assert!(object.position().x > 0.33, "{:?}", object.position());
    assert!(object.position().z.abs() < 1e-9);
}

#[test]
fn object_on_another_stays_and_rides_along() {
    let base = cube(0.30, 0.0);
    let mut top = cube(0.30, 0.005);
    top.pose.translation.vector.z = 0.06;
    let mut world = hand(0.2, 0.1, 0.1, 0.0, vec![base, top]);
    world.step(&action(0.0, 0.0, 0.0, 0.0));
    assert!((world.objects()[1].position().z - 0.04).abs() < 1e-9);
    world.carry(0, Vector2::new(0.03, 0.0), 0.0);
    assert!((world.objects()[1].position().x - 0.33).abs() < 1e-9);
}

#[test]
fn fingers_do_not_enter_objects_or_the_table() {
    let mut world = hand(0.25, 0.0, 0.10, 0.0, vec![cube(0.25, 0.0)]);
    let mut applied = 0.0;
    for _ in 0..5 {
        applied += world.step(&action(0.0, 0.0, -0.04, 0.0)).translation.z;
    }
    assert!(world.tool().position.z > 0.035, "{:?}", world.tool());
    assert!((world.tool().position.z - 0.10 - applied).abs() < 1e-12);
    let mut world = hand(0.25, 0.0, 0.10, 0.0, vec![]);
    for _ in 0..5 {
        world.step(&action(0.0, 0.0, -0.04, 0.0));
    }
    assert!(gripper::lowest(&world.tool().frame(), 0.0) > 0.0);
}

#[test]
fn applied_action_is_the_change_of_pose() {
    let mut world = hand(0.30, 0.10, 0.14, 1.0, vec![]);
    let before = *world.tool();
    let command = EndEffectorAction {
        translation: Vector3::new(0.04, 0.04, 0.04),
        rotation: Vector3::new(0.2, 0.1, -0.2),
        gripper: 0.0,
    };
    let applied = world.step(&command);
    assert!(applied.translation.norm() < command.translation.norm());
    assert!((before.position + applied.translation - world.tool().position).norm() < 1e-12);
    assert!((before.rpy + applied.rotation - world.tool().rpy).norm() < 1e-12);
}
