// Data on demand. A page that was opened from disk may not fetch files, but it may load scripts; each data script calls zeroshop.data().

const loading = new Map();
const arrived = new Map();

window.zeroshop = {
  data(content) {
    arrived.set(document.currentScript.src, content);
  },
};

/** The content of a data script, which is loaded once. */
export function load(url) {
  const place = new URL(url, document.baseURI).href;
  if (!loading.has(place)) {
    loading.set(
      place,
      new Promise((resolve, reject) => {
        const script = document.createElement("script");
        script.src = place;
        script.onload = () => (arrived.has(place) ? resolve(arrived.get(place)) : reject(new Error(`${url} holds no data`)));
        script.onerror = () => reject(new Error(`${url} could not be read`));
        document.head.append(script);
      }),
    );
  }
  return loading.get(place);
}

/** Bytes from base64, as an array of the given kind. */
export function decoded(text, Kind) {
  return new Kind(Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0)).buffer);
}
