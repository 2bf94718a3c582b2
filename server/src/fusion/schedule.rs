//! Times of snapshots: steady ticks and, in prompt mode, as soon as a frame was fused.

use std::time::{Duration, Instant};

/// Minimum time between two prompt snapshots: at most 1000 a second, the highest steady rate.
const MIN_PROMPT_PERIOD: Duration = Duration::from_millis(1);

#[derive(Clone, Copy, Debug)]
pub struct PublishSchedule {
    period: Duration,
    is_prompt: bool,
    tick: Instant,
    /// Time of the newest snapshot between ticks.
    last_prompt: Instant,
}

impl PublishSchedule {
    pub fn new(period: Duration, is_prompt: bool) -> Self {
        let now = Instant::now();
        Self { period, is_prompt, tick: now + period, last_prompt: now }
    }

    pub fn tick(&self) -> Instant {
        self.tick
    }

    /// When the next snapshot is due; `has_news`: frames were fused since the last one.
    pub fn due(&self, has_news: bool) -> Instant {
        if self.is_prompt && has_news {
            self.tick.min(self.last_prompt + MIN_PROMPT_PERIOD)
        } else {
            self.tick
        }
    }

    /// The instant to which a snapshot published `now` is predicted.
    pub fn pose_time(&self, now: Instant) -> Instant {
        if self.is_prompt { self.tick.min(now) } else { self.tick }
    }

    /// Records a published snapshot. After a stall, missed ticks are skipped.
    pub fn publish(&mut self, begun: Instant, published: Instant) {
        if self.pose_time(begun) != self.tick {
            self.last_prompt = begun;
            return;
        }
        self.tick += self.period;
        while self.tick <= published {
            self.tick += self.period;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD: Duration = Duration::from_millis(16);

    #[test]
    fn a_steady_schedule_waits_for_its_ticks() {
        let mut schedule = PublishSchedule::new(PERIOD, false);
        let first = schedule.tick();
        assert_eq!([schedule.due(true), schedule.due(false)], [first; 2]);
        let late = first + Duration::from_millis(1);
        assert_eq!(schedule.pose_time(late), first);
        schedule.publish(late, late);
        assert_eq!(schedule.tick(), first + PERIOD);
        // Two were missed.
        schedule.publish(first + PERIOD, first + 3 * PERIOD + Duration::from_millis(2));
        assert_eq!(schedule.tick(), first + 4 * PERIOD);
    }

    #[test]
    fn prompt_snapshots_do_not_move_the_ticks() {
        let mut schedule = PublishSchedule::new(PERIOD, true);
        let first = schedule.tick();
        let news = first - Duration::from_millis(9);
        assert_eq!(schedule.due(false), first);
        assert!(schedule.due(true) < news, "the last one is long ago");
        assert_eq!(schedule.pose_time(news), news);
        schedule.publish(news, news + Duration::from_micros(200));
        assert_eq!(schedule.tick(), first);
        // News that follows at once waits for the minimum period, but not past the tick.
        assert_eq!(schedule.due(true), news + MIN_PROMPT_PERIOD);
        let again = first - Duration::from_micros(300);
        schedule.publish(again, again);
        assert_eq!(schedule.due(true), first);
        schedule.publish(first, first);
        assert_eq!(schedule.tick(), first + PERIOD);
        // A snapshot at a tick does not delay news.
        let next = first + PERIOD;
        schedule.publish(next, next);
        assert!(schedule.due(true) < next);
    }
}
