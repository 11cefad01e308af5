//! Options of the program for the line as a whole: station aliases, and cables that are out for a time.

use std::str::FromStr;
use std::time::Duration;

use clap::Args;
use servocrab_sim::Segment;

/// Positions are counted from 0.
#[derive(Args, Clone, Debug)]
pub(crate) struct LineArguments {
    /// Station alias of the device at position POS, such as 1=7; as often as there are devices
    #[arg(long, value_name = "POS=N")]
    alias: Vec<Alias>,
    /// The cable in front of the device at position POS is out from FROM to TO, in seconds since the first frame, such as 1@2..4.5; as
    /// often as one likes
    #[arg(long, value_name = "POS@FROM..TO")]
    unplug: Vec<Unplugged>,
}

impl LineArguments {
    /// Gives the devices their aliases. The cables are as they are until [`Cables::at`].
    ///
    /// # Errors
    ///
    /// A text when there is no device at one of the positions, or two aliases are for one device.
    pub(crate) fn apply(&self, segment: &mut Segment) -> Result<Cables, String> {
        let devices = segment.len();
        let nobody = |position| {
            format!("there is no SubDevice {position}: the line has {devices}, counted from 0")
        };
        for (number, Alias { position, alias }) in self.alias.iter().enumerate() {
            let before = self.alias.iter().take(number);
            if before.into_iter().any(|other| other.position == *position) {
                return Err(format!("--alias stands twice for SubDevice {position}"));
            }
            let device = segment.device_mut(*position);
            device.ok_or_else(|| nobody(*position))?.set_alias(*alias);
        }
        let cables = self.unplug.iter().map(|cable| cable.position);
        if let Some(position) = cables.max().filter(|position| *position >= devices) {
            return Err(nobody(position));
        }
        Ok(Cables {
            unplugged: self.unplug.clone(),
            out: vec![false; devices],
        })
    }
}

/// A station alias, and the position of the device that gets it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Alias {
    position: usize,
    alias: u16,
}

impl FromStr for Alias {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let parts = text.split_once('=').and_then(|(position, alias)| {
            let position = position.parse().ok()?;
            let alias = alias.parse().ok()?;
            Some(Self { position, alias })
        });
        parts.ok_or_else(|| {
            "expected a position and an alias up to 65535, such as 1=7; the first device is 0"
                .into()
        })
    }
}

/// A cable that is out for a time, by the position of the device behind it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Unplugged {
    position: usize,
    from: Duration,
    to: Duration,
}

impl FromStr for Unplugged {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let seconds = |text: &str| Duration::try_from_secs_f64(text.parse().ok()?).ok();
        let parts = text.split_once('@').and_then(|(position, times)| {
            let (from, to) = times.split_once("..")?;
            Some(Self {
                position: position.parse().ok()?,
                from: seconds(from)?,
                to: seconds(to)?,
            })
        });
        match parts {
            None => Err("expected a position and two times in seconds, such as 1@2..4.5; the first device is 0".into()),
            Some(cable) if cable.from >= cable.to => {
                Err("the cable is put back before it is pulled: the second time must be the later one".into())
            }
            Some(cable) => Ok(cable),
        }
    }
}

/// The cables that come and go.
#[derive(Debug)]
pub(crate) struct Cables {
    unplugged: Vec<Unplugged>,
    /// Which are out, by the position of the device behind them.
    out: Vec<bool>,
}

impl Cables {
    /// Pulls cables and puts them back, as they are this long after the first frame.
    pub(crate) fn at(&mut self, elapsed: Duration, segment: &mut Segment) {
        for (position, out) in self.out.iter_mut().enumerate() {
            let here = self.unplugged.iter();
            let mut here = here.filter(|cable| cable.position == position);
            let now = here.any(|cable| (cable.from..cable.to).contains(&elapsed));
            match (*out, now) {
                (false, true) => segment.unplug(position),
                (true, false) => segment.plug_in(position),
                _ => {}
            }
            *out = now;
        }
    }
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use servocrab_sim::personality;

    use super::*;

    #[derive(Parser)]
    struct Program {
        #[command(flatten)]
        line: LineArguments,
    }

    /// The segment of two couplers and its cables, or what the user reads.
    fn two(arguments: &[&str]) -> Result<(Segment, Cables), String> {
        let all = ["program"].iter().chain(arguments);
        let program = Program::try_parse_from(all).map_err(|error| error.to_string())?;
        let mut segment = Segment::new()
            .with(personality::coupler())
            .with(personality::coupler());
        let cables = program.line.apply(&mut segment)?;
        Ok((segment, cables))
    }

    /// How many devices answer.
    fn answers(segment: &mut Segment) -> u8 {
        let mut frame = vec![0xFF; 12];
        frame.extend([0x88, 0xA4, 13, 0x10, 7, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0]);
        segment.process(&mut frame, Duration::ZERO);
        frame[27]
    }

    #[test]
    fn devices_have_the_aliases_that_they_were_given() {
        let (segment, _) = two(&["--alias", "1=7", "--alias", "0=65535"]).unwrap();
        let devices = segment.devices().iter();
        let aliases: Vec<_> = devices.map(|device| device.description().alias).collect();
        assert_eq!(aliases, [65_535, 7]);
    }

    #[test]
    fn a_cable_is_out_for_its_times() {
        let arguments = [
            "--unplug", "1@1..2", "--unplug", "1@2.5..3", "--unplug", "0@4..5",
        ];
        let (mut segment, mut cables) = two(&arguments).unwrap();
        let mut seen = Vec::new();
        for tenths in [0, 9, 10, 19, 20, 25, 30, 40, 50] {
            cables.at(Duration::from_millis(100 * tenths), &mut segment);
            seen.push(answers(&mut segment));
        }
        assert_eq!(seen, [2, 2, 1, 1, 2, 1, 2, 0, 2]);
    }

    #[test]
    fn cables_that_are_out_at_once_come_back_one_by_one() {
        let (mut segment, mut cables) = two(&["--unplug", "0@1..3", "--unplug", "1@2..4"]).unwrap();
        let mut at = |seconds| {
            cables.at(Duration::from_secs(seconds), &mut segment);
            answers(&mut segment)
        };
        assert_eq!([at(1), at(2), at(3), at(4)], [0, 0, 1, 2]);
    }

    #[test]
    fn what_is_no_alias_and_no_cable_is_refused_with_an_example() {
        for text in ["", "1", "=7", "1=", "1=65536", "-1=7", "a=7"] {
            let error = two(&[&format!("--alias={text}")]).unwrap_err();
            assert!(error.contains("such as 1=7"), "{error}");
        }
        for text in [
            "", "1", "1@2", "@1..2", "1@1..", "1@-1..2", "x@1..2", "1@1..inf", "1@1..NaN",
        ] {
            let error = two(&[&format!("--unplug={text}")]).unwrap_err();
            assert!(error.contains("such as 1@2..4.5"), "{error}");
        }
        for text in ["1@2..2", "1@3..2"] {
            let error = two(&["--unplug", text]).unwrap_err();
            assert!(
                error.contains("the second time must be the later one"),
                "{error}"
            );
        }
    }

    #[test]
    fn a_device_that_is_not_there_is_named_and_an_alias_is_given_once() {
        for arguments in [["--alias", "2=7"], ["--unplug", "2@1..2"]] {
            let error = two(&arguments).unwrap_err();
            assert_eq!(
                error,
                "there is no SubDevice 2: the line has 2, counted from 0"
            );
        }
        let error = two(&["--alias", "1=7", "--alias", "1=8"]).unwrap_err();
        assert_eq!(error, "--alias stands twice for SubDevice 1");
    }
}
