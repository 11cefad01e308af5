//! One axis, moved: by a velocity for a time, to its home, or to a position. All else on the line stays as it is.

use std::time::Duration;

use clap::Args;
use serde_json::{Value, json};
use servocrab::{
    Axis, AxisConfig, BufferMode, DriveConfig, HomingMethod, HomingParameters, Network,
    Referencing, SetPoint, coe::obj, profile_velocity::JogSetPoint,
};

use crate::{
    line::{DriveArguments, LineArguments, found},
    output::{Done, Failure, Interrupted, Tool},
    report::description_of,
};

/// Which axis, and how it is driven.
#[derive(Args)]
pub(crate) struct AxisArguments {
    #[command(flatten)]
    line: LineArguments,
    #[command(flatten)]
    drive: DriveArguments,
    /// Number of the axis in the drive, from 1
    #[arg(long, default_value_t = 1, value_parser = clap::value_parser!(u8).range(1..=8))]
    axis: u8,
    /// Time from one cycle to the next, in microseconds
    #[arg(long, default_value_t = 1000, value_parser = clap::value_parser!(u32).range(100..=20_000))]
    cycle_us: u32,
    /// After this time without process data the drive stops by itself, in milliseconds; without it: twenty cycles, at least 100 ms
    #[arg(long, value_parser = clap::value_parser!(u64).range(1..=6500))]
    watchdog_ms: Option<u64>,
    /// Move without a question
    #[arg(long)]
    yes: bool,
}

/// Moves with a velocity for a time, and stops. Ctrl-C stops at once.
#[derive(Args)]
pub(crate) struct Jog {
    #[command(flatten)]
    axis: AxisArguments,
    /// Target velocity 60FFh, in the drive's units; its sign is the direction
    #[arg(long, allow_negative_numbers = true)]
    velocity: i32,
    /// Profile acceleration and deceleration 6083h and 6084h; without it, what the drive holds
    #[arg(long)]
    acceleration: Option<u32>,
    /// How long to move
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=60_000))]
    milliseconds: u32,
}

/// Has the drive find its home. Ctrl-C stops at once.
#[derive(Args)]
pub(crate) struct Home {
    #[command(flatten)]
    axis: AxisArguments,
    /// Homing method 6098h: 17 negative limit switch, 18 positive, 33 and 34 index pulse, 37 where it stands
    #[arg(long, allow_negative_numbers = true)]
    method: i8,
    /// Speeds 6099h:1 and 6099h:2 during the search for the switch and for zero; without them, what the drive holds
    #[arg(long, num_args = 2, value_names = ["SWITCH", "ZERO"])]
    speeds: Option<Vec<u32>>,
    /// Homing acceleration 609Ah; without it, what the drive holds
    #[arg(long)]
    acceleration: Option<u32>,
    /// Home offset 607Ch; without it, what the drive holds
    #[arg(long, allow_negative_numbers = true)]
    offset: Option<i32>,
    /// An axis that has not found its home after so many seconds is stopped
    #[arg(long, default_value_t = 60, value_parser = clap::value_parser!(u32).range(1..=3600))]
    seconds: u32,
}

/// Moves to a position or by a distance. Ctrl-C stops at once.
#[derive(Args)]
#[command(group(clap::ArgGroup::new("target").required(true).args(["to", "by"])))]
pub(crate) struct Move {
    #[command(flatten)]
    axis: AxisArguments,
    /// To this position, in counts; the axis must know where it is
    #[arg(long, allow_negative_numbers = true)]
    to: Option<i32>,
    /// By this distance, in counts
    #[arg(long, allow_negative_numbers = true)]
    by: Option<i32>,
    /// Profile velocity 6081h, in the drive's units
    #[arg(long)]
    velocity: u32,
    /// Profile acceleration and deceleration 6083h and 6084h; without it, what the drive holds
    #[arg(long)]
    acceleration: Option<u32>,
    /// The position is a count of the drive, wherever that began: move without a homing
    #[arg(long)]
    unreferenced: bool,
}

pub(crate) async fn jog(tool: &Tool, arguments: &Jog) -> Done {
    let config = |axis: AxisConfig| axis.map_output(obj::TARGET_VELOCITY);
    let what = format!(
        "jog with {} for {} ms",
        arguments.velocity, arguments.milliseconds
    );
    let time = Duration::from_millis(arguments.milliseconds.into());
    run(tool, &arguments.axis, &what, config, async |net, axis| {
        let velocities = axis.profile_velocity().await?;
        let mut set_point = JogSetPoint::new(arguments.velocity);
        if let Some(ramp) = arguments.acceleration {
            set_point = set_point.acceleration(ramp).deceleration(ramp);
        }
        let held = velocities.jog(set_point).await?;
        net.clock().sleep(time).await?;
        // With the reason, where something has ended it meanwhile.
        held.release().await?;
        velocities.release().await?;
        Ok("jogged".into())
    })
    .await
}

pub(crate) async fn home(tool: &Tool, arguments: &Home) -> Done {
    let mut parameters = HomingParameters::new(HomingMethod(arguments.method));
    if let Some([switch, zero]) = arguments.speeds.as_deref() {
        parameters = parameters.speeds(*switch, *zero);
    }
    if let Some(acceleration) = arguments.acceleration {
        parameters = parameters.acceleration(acceleration);
    }
    if let Some(offset) = arguments.offset {
        parameters = parameters.offset(offset);
    }
    let what = format!("home by method {}", arguments.method);
    run(
        tool,
        &arguments.axis,
        &what,
        |axis| axis,
        async |_, axis| {
            let homing = axis.homing().await?;
            let limit = Duration::from_secs(arguments.seconds.into());
            let homed = homing.home(parameters).within(limit).await?;
            homing.release().await?;
            Ok(format!("homed at {}", homed.position))
        },
    )
    .await
}

pub(crate) async fn move_axis(tool: &Tool, arguments: &Move) -> Done {
    let referencing = match arguments.unreferenced {
        true => Referencing::UnreferencedMovesAllowed,
        false => Referencing::ByHoming,
    };
    let what = match arguments.to {
        Some(target) => format!("move to {target} with {}", arguments.velocity),
        None => format!(
            "move by {} with {}",
            arguments.by.unwrap_or(0),
            arguments.velocity
        ),
    };
    let config = |axis: AxisConfig| axis.referencing(referencing);
    run(tool, &arguments.axis, &what, config, async |_, axis| {
        let positions = axis.profile_position().await?;
        // The axis stands, and some drives can replace no move.
        let mut set_point = SetPoint::new()
            .velocity(arguments.velocity)
            .buffer_mode(BufferMode::Buffered);
        if let Some(ramp) = arguments.acceleration {
            set_point = set_point.acceleration(ramp).deceleration(ramp);
        }
        let motion = match arguments.to {
            Some(target) => {
                let begun = positions.move_abs(target, set_point).await;
                begun.map_err(|error| match error.failure() {
                    Some(servocrab::axis::Failure::NotReferenced) => Failure::from(
                        "the axis is not referenced: home it by `servocrab home`, or say --unreferenced to take the drive's counts as they are",
                    ),
                    _ => error.into(),
                })?
            }
            None => {
                positions
                    .move_rel(arguments.by.unwrap_or(0), set_point)
                    .await?
            }
        };
        let outcome = motion.done().await?;
        positions.release().await?;
        Ok(outcome.to_string())
    })
    .await
}

/// Brings the drive into OP, enables the axis, does the work, and disables it, whatever becomes of the work.
async fn run(
    tool: &Tool,
    arguments: &AxisArguments,
    what: &str,
    config: impl Fn(AxisConfig) -> AxisConfig,
    work: impl AsyncFnOnce(&Network, &Axis) -> Result<String, Failure>,
) -> Done {
    let line = arguments.line.scan(tool).await?;
    let drive = tool
        .unless_interrupted(declared(arguments, &line, config))
        .await;
    line.close().await;
    let (position, name, drive) = drive?;
    tool.agreed(
        arguments.yes,
        &format!(
            "Axis {} of {name} is going to move ({what}). Is everybody clear of it?",
            arguments.axis
        ),
    )
    .await?;
    let mut network = arguments
        .line
        .network()?
        .cycle(Duration::from_micros(arguments.cycle_us.into()))
        .drive(position, drive);
    if let Some(time) = arguments.watchdog_ms {
        network = network.watchdog(Duration::from_millis(time));
    }
    let start = async { Ok(network.start().await?) };
    let net = tool.unless_interrupted(start).await?;
    let axis = net.axis(&axis_name(position, arguments.axis))?;
    let emergencies = net.all_emergencies();
    let before = axis.status().position;
    let moved = tool
        .unless_interrupted(async {
            axis.enable().await?;
            work(&net, &axis).await
        })
        .await;
    // Stops the axis where it is moving, by halt and quick stop, then disables it.
    let disabled = axis.disable().await;
    let status = axis.status();
    while let Some(report) = emergencies.try_next() {
        tool.note(report);
    }
    let ended = net.shutdown().await;
    let left = disabled.err().map(Failure::from).into_iter();
    let left: Vec<_> = left.chain(ended.err().map(Failure::from)).collect();
    let (outcome, failed) = match moved {
        Ok(outcome) => (Some(outcome), None),
        Err(error) => (None, Some(error)),
    };
    let said = outcome.map_or(Ok(()), |outcome| {
        let json: Value = json!({
            "outcome": outcome,
            "from": before,
            "position": status.position,
            "referenced": status.referenced,
        });
        let state = if left.is_empty() { "disabled at" } else { "at" };
        let text = format_args!("{outcome}; {state} {}, from {before}\n", status.position);
        tool.say(&json, text)
    });
    let mut failures = failures(failed, left, status.position);
    failures.extend(said.err().map(Failure::from));
    let mut failures = failures.into_iter();
    let first = failures.next();
    failures.for_each(|other| tool.note(other));
    first.map_or(Ok(true), Err)
}

/// Why the move has failed, and then how the axis was left, where that is not as it should be: neither hides the other.
fn failures(failed: Option<Failure>, left: Vec<Failure>, position: i32) -> Vec<Failure> {
    let failed = failed.map(|error| match error.is::<Interrupted>() && left.is_empty() {
        true => format!("interrupted: stopped and disabled at {position}").into(),
        false => error,
    });
    failed.into_iter().chain(left).collect()
}

fn axis_name(position: u16, axis: u8) -> String {
    format!("{position}.{axis}")
}

/// The drive with all its axes; this one as the work needs it.
async fn declared(
    arguments: &AxisArguments,
    line: &servocrab::bus::Line,
    config: impl Fn(AxisConfig) -> AxisConfig,
) -> Result<(u16, String, DriveConfig), Failure> {
    let id = arguments.drive.of(&found(line))?.drive();
    let device = line.devices().get(usize::from(id.position));
    let description = match device {
        Some(device) => description_of(device).await,
        None => None,
    };
    let description =
        description.ok_or_else(|| format!("{id} is no drive: it has no statusword"))?;
    let axes = description.axes.len();
    if usize::from(arguments.axis) > axes {
        return Err(format!("{id} has {axes} axes, and no axis {}", arguments.axis).into());
    }
    let mut drive = DriveConfig::new(description);
    for number in (1..=8).take(axes) {
        let axis = AxisConfig::new(axis_name(id.position, number));
        drive = drive.axis(if number == arguments.axis {
            config(axis)
        } else {
            axis
        });
    }
    Ok((id.position, id.to_string(), drive))
}

#[cfg(test)]
mod tests {
    use servocrab::bus::NetworkError;

    use super::*;

    #[test]
    fn an_axis_that_is_left_moving_is_named_whatever_became_of_its_move() {
        let moving = || Failure::from(NetworkError::StillMoving(Vec::new()));
        let texts = |failed, left| {
            let all = failures(failed, left, 7);
            all.iter().map(ToString::to_string).collect::<Vec<_>>()
        };
        let still = moving().to_string();
        assert_eq!(texts(None, vec![moving()]), [still.as_str()]);
        assert_eq!(
            texts(
                Some("the drive is lost".into()),
                vec!["not disabled".into(), moving()]
            ),
            ["the drive is lost", "not disabled", &still]
        );
        assert_eq!(
            texts(Some(Interrupted.into()), vec![moving()]),
            ["interrupted", &still]
        );
        assert_eq!(
            texts(Some(Interrupted.into()), Vec::new()),
            ["interrupted: stopped and disabled at 7"]
        );
        assert!(texts(None, Vec::new()).is_empty());
    }
}
