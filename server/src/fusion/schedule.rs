//! When snapshots are published: at steady ticks and, where that is wanted, as soon as a frame has been fused.

use std::time::{Duration, Instant};

/// From one prompt snapshot to the next at least, however many frames come: 1000 a second, as at the highest steady rate.
const MIN_PROMPT_PERIOD: Duration = Duration::from_millis(1);

/// When the next snapshot is due.
#[derive(Clone, Copy, Debug)]
pub struct PublishSchedule {
    period: Duration,
    is_prompt: bool,
    tick: Instant,
    /// When the newest one between ticks was published.
    last_prompt: Instant,
}

impl PublishSchedule {
    /// Steady ticks from now on; a prompt one has snapshots between them, each as soon as there is news.
    pub fn new(period: Duration, is_prompt: bool) -> Self {
        let now = Instant::now();
        Self { period, is_prompt, tick: now + period, last_prompt: now }
    }

    pub fn tick(&self) -> Instant {
        self.tick
    }

    /// When the next snapshot is due, by whether there has been news since the one before.
    pub fn due(&self, has_news: bool) -> Instant {
        if self.is_prompt && has_news {
            self.tick.min(self.last_prompt + MIN_PROMPT_PERIOD)
        } else {
            self.tick
        }
    }

    /// To which instant the snapshot is predicted that is published `now`.
    pub fn pose_time(&self, now: Instant) -> Instant {
        if self.is_prompt { self.tick.min(now) } else { self.tick }
    }

    /// Notes that a snapshot was begun and published. After a stall missed ticks are left out instead of being caught
    /// up in a burst.
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
    fn steady_ones_wait_for_their_tick_whatever_comes() {
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
    fn prompt_ones_follow_news_and_leave_the_ticks_where_they_are() {
        let mut schedule = PublishSchedule::new(PERIOD, true);
        let first = schedule.tick();
        let news = first - Duration::from_millis(9);
        assert_eq!(schedule.due(false), first);
        assert!(schedule.due(true) < news, "nothing was published for long");
        assert_eq!(schedule.pose_time(news), news);
        schedule.publish(news, news + Duration::from_micros(200));
        assert_eq!(schedule.tick(), first);
        // More news at once has to wait a little, and never beyond the tick.
        assert_eq!(schedule.due(true), news + MIN_PROMPT_PERIOD);
        let again = first - Duration::from_micros(300);
        schedule.publish(again, again);
        assert_eq!(schedule.due(true), first);
        schedule.publish(first, first);
        assert_eq!(schedule.tick(), first + PERIOD);
        // A steady one makes no news wait.
        let next = first + PERIOD;
        schedule.publish(next, next);
        assert!(schedule.due(true) < next);
    }
}
