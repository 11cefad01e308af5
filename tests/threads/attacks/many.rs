//! Hundreds of tasks that wait: each is polled when there is something for it, and not before.

use std::{
    future::Future,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering::SeqCst},
    },
    task::{Wake, Waker},
    time::Duration,
};

use servocrab::{bus::BusLoop, link::Wire};
use servocrab_sim::{Segment, personality};

use super::{builder, poll};

const TASKS: usize = 200;

struct Woken(AtomicBool);

impl Wake for Woken {
    fn wake(self: Arc<Self>) {
        self.0.store(true, SeqCst);
    }
}

struct Task<'a> {
    future: Pin<Box<dyn Future<Output = ()> + 'a>>,
    woken: Arc<Woken>,
}

impl<'a> Task<'a> {
    fn new(future: impl Future<Output = ()> + 'a) -> Self {
        Self {
            future: Box::pin(future),
            woken: Arc::new(Woken(AtomicBool::new(true))),
        }
    }
}

/// Polls those that were woken until none is; how many polls that were.
fn poll_woken(tasks: &mut Vec<Task<'_>>, most: usize) -> usize {
    let mut polls = 0;
    loop {
        let before = polls;
        tasks.retain_mut(|task| {
            if !task.woken.0.swap(false, SeqCst) {
                return true;
            }
            polls += 1;
            let waker = Waker::from(Arc::clone(&task.woken));
            poll(&mut task.future, &waker).is_pending()
        });
        if polls == before || polls > most {
            return polls;
        }
    }
}

#[test]
fn two_hundred_tasks_asleep_on_the_cycles_clock_are_polled_once_a_cycle() {
    // No count of it changes at rest.
    let mut segment = Segment::new().with(personality::akd2g()).ideal();
    let wire = Wire::in_virtual_time(Duration::from_micros(20), move |frame: &mut [u8], now| {
        segment.process(frame, now)
    });
    let (starting, mut bus) = builder().link(wire).split().unwrap();
    let net = bus.run_until(starting.network()).unwrap();
    let turn_a_cycle = |bus: &mut BusLoop| {
        let before = net.statistics().cycles;
        while net.statistics().cycles == before {
            assert!(bus.turn());
        }
    };
    turn_a_cycle(&mut bus);
    let mut tasks: Vec<_> = (0..TASKS)
        .map(|_| {
            let clock = net.clock();
            Task::new(async move { while clock.next_cycle().await.is_ok() {} })
        })
        .collect();
    let most = 10 * TASKS;
    assert_eq!(poll_woken(&mut tasks, most), TASKS, "each begins to wait");
    assert_eq!(poll_woken(&mut tasks, most), 0, "no cycle, no poll");
    for _ in 0..50 {
        turn_a_cycle(&mut bus);
        let polls = poll_woken(&mut tasks, most);
        assert!(
            polls <= TASKS,
            "{polls} polls of {TASKS} tasks in one cycle"
        );
    }
    let sleepers = (0..TASKS).map(|_| {
        let clock = net.clock();
        Task::new(async move { drop(clock.sleep(Duration::from_secs(1)).await) })
    });
    let mut sleepers: Vec<_> = sleepers.collect();
    let axis = net.axis("x").unwrap();
    let mut watchers: Vec<_> = (0..TASKS)
        .map(|_| Task::new(async { while axis.changed().await.is_some() {} }))
        .collect();
    poll_woken(&mut watchers, most);
    poll_woken(&mut sleepers, most);
    let mut polls = 0;
    while !sleepers.is_empty() {
        turn_a_cycle(&mut bus);
        polls = poll_woken(&mut sleepers, most);
        assert!(polls <= TASKS, "{polls} polls of the sleepers in one cycle");
    }
    assert_eq!(polls, TASKS, "all at the end");
    poll_woken(&mut watchers, most);
    turn_a_cycle(&mut bus);
    assert_eq!(poll_woken(&mut watchers, most), 0, "the axis rests");
    bus.run_until(net.shutdown()).unwrap();
    poll_woken(&mut tasks, most);
    poll_woken(&mut watchers, most);
    assert!(
        tasks.is_empty() && watchers.is_empty(),
        "all hear of the end"
    );
}
