//! In this process only, on a simulated AKD2G: a program with its own ethercrab loop. It owns the `MainDevice` and the
//! `SubDeviceGroup`, and steps one axis core a cycle. On a real link `ethercrab::std::tx_rx_task` takes the place of the
//! simulated segment; the rest stays.
//!
//! Run it with `cargo run --release --example own_loop`.

#[macro_use]
#[path = "common/say.rs"]
mod say;

use std::{
    error::Error,
    process::ExitCode,
    time::{Duration, Instant},
};

use clap::Parser;
use ethercrab::{MainDevice, MainDeviceConfig, PduRx, PduStorage, PduTx, Timeouts};
use servocrab::{
    Referencing, SetPoint, StopRequest,
    axis::{AxisCore, AxisFields, Command, CommandId, CoreConfig, Event, Inputs},
    bus::arm_watchdog,
    coe::AxisOffset,
    drives,
    ds402::State,
    profile_position::{MoveCommand, Parameters, Reference},
};
use servocrab_sim::{Segment, personality};
use smol::LocalExecutor;

static STORAGE: PduStorage<16, { PduStorage::element_size(1100) }> = PduStorage::new();

const CYCLE: Duration = Duration::from_millis(1);
/// An LRW counts 1 for the inputs and 2 for the outputs of each drive.
const EXPECTED_WORKING_COUNTER: u16 = 3;

/// Runs in this process only, on a simulated AKD2G, and takes no arguments.
#[derive(Parser)]
struct Arguments {}

fn main() -> ExitCode {
    Arguments::parse();
    match begin() {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("own_loop: {error}");
            ExitCode::FAILURE
        }
    }
}

fn begin() -> Result<(), Box<dyn Error>> {
    let (tx, rx, pdu_loop) = STORAGE
        .try_split()
        .map_err(|()| "the storage is split once")?;
    let config = MainDeviceConfig {
        dc_static_sync_iterations: 0,
        ..MainDeviceConfig::default()
    };
    let main_device = MainDevice::new(pdu_loop, Timeouts::default(), config);
    let segment = Segment::new().with(personality::akd2g());

    let executor = LocalExecutor::new();
    executor.spawn(carry_frames(tx, rx, segment)).detach();
    smol::block_on(executor.run(control(&main_device)))
}

async fn control(main_device: &MainDevice<'_>) -> Result<(), Box<dyn Error>> {
    let group = main_device.init_single_group::<2, 128>(|| 0).await?;
    let group = group.into_pre_op_pdi(main_device).await?;
    for drive in group.iter(main_device) {
        say!(
            "{} at {:04X}h: watchdog 100 ms",
            drive.name(),
            drive.configured_address()
        );
        arm_watchdog(
            main_device,
            drive.configured_address(),
            Duration::from_millis(100),
        )
        .await?;
        for axis in [0x6007, 0x6807] {
            // Quick stop when the process data stop.
            drive.sdo_write(axis, 0, 3i16).await?;
        }
    }
    let group = group.into_safe_op(main_device).await?;
    // A drive wants outputs before it goes to OP; these are zero, which is Disable voltage.
    let group = group.request_into_op(main_device).await?;
    while !group.tx_rx(main_device).await?.all_op() {
        smol::Timer::after(CYCLE).await;
    }

    // The drive's default mapping is the one that the library would write; the offsets come from it.
    let description = drives::akd2g();
    let layout = description.default_mapping()?.layout();
    let mut config = CoreConfig::new(AxisFields::from_layout(&layout, AxisOffset::of_axis(1))?);
    config.traits = description.traits;
    config.defaults = Parameters {
        velocity: Some(50_000),
        acceleration: Some(500_000),
        deceleration: Some(500_000),
        ..Parameters::default()
    };
    // On the bench nothing stands in the way, and nobody homes.
    config.referencing = Referencing::UnreferencedMovesAllowed;
    let mut axis = AxisCore::new(config);

    let steps = [
        ("enable", Command::Enable),
        ("move to 10000", move_to(10_000)),
        ("move to -2500", move_to(-2_500)),
        ("disable", Command::Disable),
    ];
    let mut steps = (1..).map(CommandId).zip(steps);
    let mut under_way = None;
    let begin = Instant::now();
    let mut next = begin;
    loop {
        next += CYCLE;
        smol::Timer::at(next).await;
        let now = begin.elapsed();

        let drive = group.subdevice(main_device, 0)?;
        if under_way.is_none() {
            let Some((id, (what, command))) = steps.next() else {
                break;
            };
            say!("{:6.3} s  {what}", now.as_secs_f64());
            axis.submit(now, id, command, &mut drive.outputs_raw_mut());
            under_way = Some(id);
        }
        // A stop from elsewhere (a button, a signal) goes here, as the last thing before the exchange.
        axis.apply_stop(now, StopRequest::empty(), &mut drive.outputs_raw_mut());

        let answer = group.tx_rx(main_device).await;
        let mut io = drive.io_raw_mut();
        let inputs = io.inputs().to_vec();
        let inputs = match &answer {
            Ok(answer) => {
                Inputs::from_wkc(answer.working_counter, EXPECTED_WORKING_COUNTER, &inputs)
            }
            Err(_) => Inputs::Stale,
        };
        axis.step(now, inputs, io.outputs());
        while let Some((id, event)) = axis.poll_event() {
            say!(
                "{:6.3} s    {event:?} at {}",
                now.as_secs_f64(),
                axis.snapshot().position
            );
            if let Event::Done(result) = event {
                // On an error this program ends, and with it the frames: the drive stops by its watchdog.
                result?;
                under_way = under_way.filter(|&pending| pending != id);
            }
        }
    }
    let state = axis.snapshot().state;
    assert!(
        matches!(state, State::ReadyToSwitchOn | State::SwitchOnDisabled),
        "the axis ends disabled: {state:?}"
    );
    Ok(())
}

fn move_to(target: i32) -> Command {
    Command::Move(MoveCommand {
        reference: Reference::Absolute,
        target,
        set_point: SetPoint::new(),
        gated: false,
    })
}

/// The wire: every frame goes through the simulated segment and back.
async fn carry_frames(mut tx: PduTx<'static>, mut rx: PduRx<'static>, mut segment: Segment) {
    let begin = Instant::now();
    let mut buffer = [0; 1514];
    loop {
        while let Some(frame) = tx.next_sendable_frame() {
            let sent = frame.send_blocking(|bytes| {
                buffer[..bytes.len()].copy_from_slice(bytes);
                Ok(bytes.len())
            });
            if let Ok(length) = sent
                && segment.process(&mut buffer[..length], begin.elapsed())
            {
                // A frame that ethercrab does not know any more is not an error of the link.
                let _ = rx.receive_frame(&buffer[..length]);
            }
        }
        smol::future::yield_now().await;
    }
}
