//! One program for every drive: each `BufferMode`, halt, resume, stop, quick stop, fault, homing, over frames, on plants and in virtual
//! time. What each drive is expected to do is data, in `tests/vectors/scenario.txt`; nothing in the program knows which
//! drive it moves.

mod bench;
mod steps;

use std::fmt::Write as _;

use bench::{Bench, Subject};
use servocrab::{
    Referencing,
    drives::{self, DriveDescription},
};
use servocrab_sim::personality::Servo;

const EXPECTED: &str = include_str!("../../vectors/scenario.txt");

fn subjects() -> Vec<Subject> {
    let subject =
        |name, device: fn() -> Servo, description: fn() -> DriveDescription, jogs| Subject {
            name,
            device,
            description,
            referencing: Referencing::ByHoming,
            jogs,
        };
    vec![
        subject("akd2g", Servo::akd2g, drives::akd2g, true),
        subject("pp2010", Servo::pp2010, drives::pp2010, false),
        subject("ax2000", Servo::ax2000, drives::ax2000, true),
        subject("sigma7", Servo::sigma7, drives::sigma7, true),
        subject("generic", Servo::generic, drives::generic, true),
    ]
}

#[test]
fn every_drive_goes_through_the_same_program_and_does_what_its_documents_say() {
    let columns: Vec<_> = subjects()
        .iter()
        .map(|subject| (subject.name, run(subject)))
        .collect();
    let mut table = String::new();
    for (at, (step, _)) in steps::STEPS.iter().enumerate() {
        writeln!(table, "[{step}]").expect("a string");
        for (drive, cells) in &columns {
            writeln!(table, "{drive} | {}", cells[at]).expect("a string");
        }
    }
    println!("{table}");
    let lines = |text: &str| -> Vec<String> {
        text.lines()
            .filter(|line| !line.trim().is_empty() && !line.starts_with('#'))
            .map(str::to_owned)
            .collect()
    };
    let (found, expected) = (lines(&table), lines(EXPECTED));
    for (found, expected) in found.iter().zip(&expected) {
        assert_eq!(found, expected);
    }
    assert_eq!(found.len(), expected.len());
    assert_eq!(found.len(), steps::STEPS.len() * (1 + columns.len()));
}

/// The whole program on one drive: a line for each step.
fn run(subject: &Subject) -> Vec<String> {
    let mut bench = Bench::start(subject);
    let cells = steps::STEPS
        .iter()
        .map(|(_, step)| {
            bench.make_ready();
            step(&mut bench)
        })
        .collect();
    bench.shutdown();
    cells
}
