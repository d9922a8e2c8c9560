//! Steps of the optimiser against PyTorch's AdamW and clipping.

use std::collections::BTreeMap;

use super::*;
use crate::fixture::{Fixture, values};

#[test]
fn steps_match_pytorchs_adamw() {
    let fixture = Fixture::open("adamw");
    let shapes: BTreeMap<String, Vec<usize>> = fixture.of("shapes");
    let count = |shape: &[usize]| shape.iter().product();
    let parameters = shapes.iter().map(|(name, shape)| Parameter {
        name: name.clone(),
        shape: shape.clone(),
        values: values(name, count(shape), 1.0),
        group: 0,
    });
    let mut optimiser = AdamW::new(parameters.collect(), fixture.of("optimiser"));
    let schedule: Schedule = fixture.of("schedule");
    let scales: Vec<f64> = fixture.of("gradient_scales");
    let mut worst = 0.0_f64;
    for (step, scale) in scales.into_iter().enumerate() {
        let gradients = shapes.iter().map(|(name, shape)| {
            let name = format!("gradient of {name} at {step}");
            values(&name, count(shape), scale)
        });
        let gradients: Vec<_> = gradients.collect();
        let rate = schedule.at(optimiser.steps_taken());
        let norm = optimiser.step(&gradients, rate).unwrap();
        let mut check = |what: &str, found: &[f32]| {
            worst = worst.max(fixture.check_one(&format!("{step}/{what}"), found));
        };
        check("norm", &[norm as f32]);
        for weight in optimiser.weights() {
            check(&format!("after/{}", weight.name), weight.values);
        }
        for weight in optimiser.averaged() {
            check(&format!("averaged/{}", weight.name), weight.values);
        }
    }
    println!("weights and averages to {worst:.1e}");
}
