//! Handles in several threads while the cycle runs in another.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread,
    time::Duration,
};

use servocrab::SetPoint;

use crate::machine::Machine;

#[test]
fn handles_in_many_threads_lose_no_wake_up_and_the_ledger_has_every_move_once() {
    let mut machine = Machine::new(2);
    let axes = [machine.axis(0), machine.axis(1)];
    let drives: Vec<_> = machine
        .stations
        .iter()
        .map(|station| Arc::clone(&station.drive))
        .collect();
    let over = Arc::new(AtomicBool::new(false));
    let cycle = {
        let over = Arc::clone(&over);
        thread::spawn(move || {
            while !over.load(Ordering::Relaxed) {
                machine.cycle();
                thread::yield_now();
            }
        })
    };
    let movers: Vec<_> = axes
        .into_iter()
        .map(|axis| {
            thread::spawn(move || {
                smol::block_on(async {
                    axis.enable().await.unwrap();
                    let pp = axis.profile_position().await.unwrap();
                    let watched = axis.clone();
                    let watcher = async {
                        loop {
                            let _ = watched.changed().await;
                        }
                    };
                    let mover = async {
                        for _ in 0..25 {
                            let moved = pp.move_rel(40, SetPoint::new()).await.unwrap();
                            moved.done().within(Duration::from_secs(60)).await.unwrap();
                        }
                        axis.disable().await.unwrap();
                    };
                    smol::future::or(mover, watcher).await;
                });
            })
        })
        .collect();
    for mover in movers {
        mover.join().unwrap();
    }
    over.store(true, Ordering::Relaxed);
    cycle.join().unwrap();
    for drive in drives {
        assert_eq!(drive.lock().unwrap().ledger().len(), 25);
        assert!((drive.lock().unwrap().position() - 1_000).abs() <= 10);
    }
}
