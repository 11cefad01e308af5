//! SDO transfers of many tasks and many drives beside the cycle.

use std::{future::Future, time::Duration};

use servocrab::{
    AxisConfig, DriveConfig, Network, Referencing,
    coe::{DriveError, SdoError, obj},
    drives,
};
use servocrab_sim::{
    Segment,
    personality::{self, Servo},
};

use crate::rig::{Line, Rig};

const DRIVES: u16 = 4;

fn rig() -> (Line, Rig) {
    let segment = (0..DRIVES).fold(Segment::new(), |segment, _| {
        segment.with(personality::akd2g())
    });
    let line = Line::new(segment);
    let builder = (0..DRIVES).fold(Network::builder().link(line.wire()), |builder, position| {
        let axis = |number| format!("{position}{number}");
        let drive = DriveConfig::new(drives::akd2g())
            .axis(AxisConfig::new(axis(1)).referencing(Referencing::UnreferencedMovesAllowed))
            .axis(axis(2));
        builder.drive(position, drive)
    });
    (line, Rig::start(builder).unwrap())
}

/// Runs all futures at once.
pub(crate) async fn all<T: 'static>(futures: Vec<impl Future<Output = T> + 'static>) -> Vec<T> {
    let executor = smol::LocalExecutor::new();
    let tasks: Vec<_> = futures.into_iter().map(|one| executor.spawn(one)).collect();
    let results = async {
        let mut results = Vec::new();
        for task in tasks {
            results.push(task.await);
        }
        results
    };
    executor.run(results).await
}

#[test]
fn many_tasks_transfer_long_texts_with_many_drives_in_op_and_no_cycle_is_lost() {
    let (_line, mut rig) = rig();
    let before = rig.net().statistics();
    let tasks: Vec<_> = (0..DRIVES)
        .flat_map(|position| (0..3u8).map(move |task| (position, task)))
        .map(|(position, task)| {
            let sdo = rig.net().sdo(position).unwrap();
            async move {
                // Three texts longer than the mailbox, one after the other; what is read is a whole one of them.
                let text = |task: u8| vec![b'a' + task; 3_000 + usize::from(position)];
                sdo.write_bytes(0x5F00, 0, text(task)).await?;
                let read = sdo.read_bytes(0x5F00, 0).await?;
                assert!((0..3).any(|task| read == text(task)), "{position}");
                let axis = 1 + task % 2;
                let window = obj::POSITION_WINDOW.axis(axis);
                sdo.write(window, 1_000 + u32::from(position)).await?;
                assert_eq!(sdo.read(window).await?, 1_000 + u32::from(position));
                Ok::<_, DriveError>(())
            }
        })
        .collect();
    let started = rig.bus.now();
    let results = rig.until(all(tasks));
    assert_eq!(results.len(), 12);
    for result in results {
        result.unwrap();
    }
    let cycles = rig.net().statistics().cycles - before.cycles;
    let elapsed = rig.bus.now() - started;
    assert!(elapsed < Duration::from_secs(2), "{elapsed:?}");
    assert!(
        u128::from(cycles) + 2 >= elapsed.as_millis(),
        "{cycles} in {elapsed:?}"
    );
    let after = rig.net().statistics();
    assert_eq!(
        (after.lost, after.late_cycles),
        (before.lost, before.late_cycles)
    );
    rig.shutdown();
}

#[test]
fn a_slow_drive_costs_its_own_requests_their_deadline_and_the_other_drives_nothing() {
    let (line, mut rig) = rig();
    let slow = Duration::from_millis(50);
    line.segment()
        .device_mut(0)
        .unwrap()
        .set_mailbox_delay(slow);
    let patient = rig.net().sdo(0).unwrap();
    let deadline = Duration::from_millis(20);
    let impatient = patient.clone().with_timeout(deadline);
    let other = rig.net().sdo(1).unwrap();
    let started = rig.bus.now();
    let (refused, read) = rig.until(smol::future::zip(impatient.read(obj::VENDOR_ID), async {
        let mut read = Vec::new();
        while read.len() < 10 {
            read.push(other.read(obj::VENDOR_ID).await);
        }
        read
    }));
    assert!(rig.bus.now() - started < slow);
    assert!(read.iter().all(Result::is_ok), "{read:?}");
    let error = refused.unwrap_err();
    assert_eq!(error.drive.position, 0);
    assert!(
        matches!(error.error, SdoError::Timeout { after, .. } if after == deadline),
        "{error}"
    );
    // Its late reply is not taken for that of the next one.
    assert_eq!(
        rig.until(patient.read(obj::PRODUCT_CODE)).unwrap(),
        0x414B_4432
    );
    assert_eq!(rig.until(patient.read(obj::VENDOR_ID)).unwrap(), 0x6A);
    rig.shutdown();
}

#[test]
fn a_mailbox_that_is_longer_than_a_datagram_is_used_as_far_as_one_carries_it() {
    for bytes in [1470, 1471, 1486] {
        let drive = Servo::akd2g().mailboxes_at(0x1800, 0x1E00, bytes);
        let line = Line::new(Segment::new().with(drive.build()));
        let drive = DriveConfig::new(drives::akd2g()).axis("x");
        let mut rig = Rig::start(Network::builder().link(line.wire()).drive(0, drive))
            .unwrap_or_else(|error| panic!("{bytes} bytes: {error}"));
        let sdo = rig.net().sdo(0).unwrap();
        // In one mail of the shorter mailbox, in one of the longer one alone, and in several.
        for length in [1454, 1470, 3_000] {
            let text: Vec<u8> = (b'a'..=b'z').cycle().take(length).collect();
            rig.until(sdo.write_bytes(0x5F00, 0, text.clone())).unwrap();
            let read = rig.until(sdo.read_bytes(0x5F00, 0)).unwrap();
            assert!(read == text, "{length} in mailboxes of {bytes} bytes");
        }
        rig.shutdown();
    }
}

/// A program keeps the futures of seventeen reads and polls none of them again. The drive has answered each. A further read ends, and
/// each kept future gives its own result.
#[test]
fn transfers_whose_futures_are_kept_after_their_answer_hold_up_no_other() {
    use servocrab::{Network, coe::obj};
    use servocrab_sim::{Segment, personality};
    use std::{
        pin::pin,
        task::{Context, Poll, Waker},
        time::Duration,
    };
    let line = crate::rig::Line::new(Segment::new().with(personality::akd2g()));
    let builder = Network::builder()
        .link(line.wire())
        .drive(0, crate::rig::akd2g());
    let mut rig = crate::rig::Rig::start(builder).unwrap();
    let sdo = rig.net().sdo(0).unwrap();
    let mut cx = Context::from_waker(Waker::noop());
    let mut kept = Vec::new();
    for _ in 0..17 {
        let sdo = sdo.clone();
        let mut read = Box::pin(async move { sdo.read(obj::STATUSWORD).await });
        assert!(read.as_mut().poll(&mut cx).is_pending());
        rig.run_for(Duration::from_millis(20));
        kept.push(read);
    }
    let limited = sdo.clone().with_timeout(Duration::from_millis(100));
    let mut read = pin!(limited.read(obj::STATUSWORD));
    let end = rig.bus.now() + Duration::from_secs(10);
    let mut ready = false;
    while rig.bus.now() < end && !ready {
        ready = matches!(read.as_mut().poll(&mut cx), Poll::Ready(_));
        assert!(rig.bus.turn());
    }
    assert!(
        ready,
        "a read with a time limit of 100 ms has no end after 10 s"
    );
    for read in kept {
        rig.until(read).unwrap();
    }
}
