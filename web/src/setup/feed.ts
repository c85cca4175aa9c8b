import { Socket } from "../api";
import type { Job, JobsMessage } from "../protocol";

/** The server's jobs, kept up to date; calls back after every change. */
export class JobFeed {
  readonly jobs = new Map<string, Job>();
  /** Whether the server answers; before its first answer too. */
  connected = true;
  private readonly socket: Socket;

  /** changed: a job has changed; files: a job has ended, and what it has made or found is to be read. */
  constructor(
    private readonly changed: (job: Job | null) => void,
    private readonly files: () => void,
  ) {
    this.socket = new Socket("/ws/jobs", (message) => this.take(message as JobsMessage), undefined, (open) => {
      if (open === this.connected) return;
      this.connected = open;
      this.changed(null);
    });
  }

  /** The jobs of a recording (null: all), the newest first. */
  of(recording: string | null): Job[] {
    return [...this.jobs.values()]
      .filter((j) => recording === null || j.recording === recording)
      .sort((a, b) => b.created - a.created);
  }

  close(): void {
    this.socket.close();
  }

  private take(message: JobsMessage): void {
    if (message.t === "files") return this.files();
    if (message.t === "jobs") {
      this.jobs.clear();
      for (const job of message.jobs) this.jobs.set(job.id, job);
      return this.changed(null);
    }
    this.jobs.set(message.job.id, message.job);
    this.changed(message.job);
  }
}

export function active(job: Job): boolean {
  return job.state === "queued" || job.state === "running";
}
