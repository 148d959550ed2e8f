/* Search on pages that are opened from the disk, where browsers start no worker: what the worker would run
   runs in a hidden frame instead, and messages go to and fro as they would. Nothing is fetched.
   The design is that of squidfunk/iframe-worker (MIT). */
if (location.protocol === "file:") {
  window.Worker = class extends EventTarget {
    constructor(url) {
      super();
      this.frame = document.createElement("iframe");
      this.frame.hidden = true;
      document.body.append(this.frame);
      const inside = this.frame.contentWindow;
      inside.postMessage = (data) => this.dispatchEvent(new MessageEvent("message", { data }));
      inside.importScripts = () => {};
      const script = inside.document.createElement("script");
      this.ready = new Promise((done) => { script.onload = done; });
      script.src = url;
      inside.document.body.append(script);
    }
    postMessage(data) {
      const inside = this.frame.contentWindow;
      this.ready.then(() => inside.dispatchEvent(new inside.MessageEvent("message", { data })));
    }
    terminate() { this.frame.remove(); }
    set onmessage(hear) { this.addEventListener("message", hear); }
    set onerror(hear) { this.addEventListener("error", hear); }
  };
}
/* The name of an option is searched for without its dashes: for lunr a leading "-" means "without this word", and
   two of them are no query at all. */
{
  const QUERY = 2; // of the messages that the theme's search sends
  const post = Worker.prototype.postMessage;
  Worker.prototype.postMessage = function (message, ...rest) {
    const asked = message?.type === QUERY && typeof message.data === "string";
    const sent = asked ? { ...message, data: message.data.replace(/(^|\s)-+(?=\w)/g, "$1") } : message;
    return post.call(this, sent, ...rest);
  };
}
