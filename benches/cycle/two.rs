//! Two lines in one process, each with a cable and a thread of its own: whether they disturb each other.

use std::{
    io::{self, BufRead},
    process,
    sync::mpsc::{Receiver, Sender, channel},
    thread,
};

use crate::{
    PAIRS, ROUNDS, Row,
    measure::{Measured, Mode, cpu_ns, say},
    medians, place_of,
    talk::Talk,
};

const CYCLES: usize = 2000;

/// Says that both lines are ready, and runs cycles on the first (`alone`) or on both (`both`) as often as it is asked to.
pub(crate) fn two<R: FnMut(Mode, usize) -> Measured>(
    interfaces: [&str; 2],
    bring_up: impl Fn(&str) -> R + Sync,
) {
    thread::scope(|scope| {
        let bring_up = &bring_up;
        let lines = interfaces.map(|interface| {
            let (orders, ordered) = channel();
            let (told, tells) = channel();
            scope.spawn(move || run(bring_up(interface), &ordered, &told));
            (orders, tells)
        });
        for (_, tells) in &lines {
            tells.recv().expect("it comes up");
        }
        say("ready");
        for line in io::stdin().lock().lines() {
            let line = line.expect("text");
            let (which, cycles) = line.split_once(' ').expect("which lines, and a number");
            let cycles: usize = cycles.parse().expect("a number");
            let lines = &lines[..if which == "both" { 2 } else { 1 }];
            let cpu = cpu_ns();
            for (orders, _) in lines {
                orders.send(cycles).expect("it listens");
            }
            let mut measured: Vec<_> = lines
                .iter()
                .map(|(_, tells)| tells.recv().expect("it answers"))
                .collect();
            let cpu = (cpu_ns() - cpu) as f64 / (cycles * lines.len()) as f64 / 1e3;
            for measured in &mut measured {
                measured.cpu = cpu;
            }
            let values: Vec<_> = measured.iter().flat_map(Measured::values).collect();
            say(&values
                .iter()
                .map(f64::to_string)
                .collect::<Vec<_>>()
                .join(" "));
        }
        // Without taking the lines down in order: nobody is there any more.
        process::exit(0);
    });
}

/// A line's thread.
fn run(
    mut cycles: impl FnMut(Mode, usize) -> Measured,
    ordered: &Receiver<usize>,
    told: &Sender<Measured>,
) {
    told.send(Measured::default()).expect("it waits");
    for count in ordered {
        // Moves this line's cycle against the other's by a random phase.
        cycles(Mode::Fast, 100);
        told.send(cycles(Mode::Paced, count)).expect("it waits");
    }
}

/// One of two lines alone and then both, with bare sockets and with this library, in turns.
pub(crate) fn in_turns(pairs: &mut [Talk], reflector: &mut Talk, axes: usize) -> Vec<Row> {
    const NAMES: [[&str; 3]; 2] = [
        ["floor-alone", PAIRS[0][0], PAIRS[0][1]],
        ["servocrab-alone", PAIRS[1][0], PAIRS[1][1]],
    ];
    let mut measured = [const { [const { Vec::new() }; 3] }; 2];
    for _ in 0..ROUNDS {
        for (pair, talk) in pairs.iter_mut().enumerate() {
            let [first, second] = PAIRS[pair].map(place_of);
            reflector.ask(&format!("reflect {first} {second}"));
            let alone = talk.measure_all(&format!("alone {CYCLES}"));
            let both = talk.measure_all(&format!("both {CYCLES}"));
            for (all, one) in measured[pair].iter_mut().zip(alone.into_iter().chain(both)) {
                all.push(one);
            }
        }
    }
    let names = NAMES.into_iter().flatten();
    let rows = names.zip(measured.into_iter().flatten());
    let rows: Vec<Row> = rows
        .map(|(who, rounds)| Row {
            who,
            axes,
            mode: Mode::Paced.name(),
            measured: medians(rounds.into_iter()),
        })
        .collect();
    rows.iter().for_each(Row::print);
    println!();
    rows
}
